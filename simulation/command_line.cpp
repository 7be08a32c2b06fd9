// SPDX-License-Identifier: Apache-2.0
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <cctype>
#include <limits>
#include <map>
#include <type_traits>

#include "simulation/options.hpp"

namespace slamgw::sim {
namespace {

constexpr int wrong_arguments = 2;
constexpr int max_boards = 4;
constexpr std::uint64_t max_number = std::numeric_limits<std::uint64_t>::max();
constexpr unsigned default_baud = 115200;    // of Nordic's serial example
constexpr std::size_t max_client_id = 23;    // MQTT-SN 1.2 section 5.3.1
constexpr std::size_t max_uuid_prefix = 12;  // leaves room for the seed and the robot's number

/// Restricts an option to these values. The help of CLI11's own transformer shows enumerators as
/// control characters.
template <typename Enum>
void take_words(CLI::Option* option, const std::map<std::string, Enum>& values) {
  std::string words;
  for (const auto& [word, value] : values) words += (words.empty() ? "" : "|") + word;
  const auto number_of = [values, words](std::string& text) {
    const auto found = values.find(text);
    if (found == values.end()) return fmt::format("'{}' is not one of {}", text, words);
    text = std::to_string(static_cast<int>(found->second));
    return std::string();
  };
  option->transform(CLI::Validator(number_of, ""))->type_name(words);
}

/// Replaces CLI::Range, which accepts "nan" and reads "-1" as a large unsigned number.
template <typename Number>
CLI::Validator in_range(Number least, Number most) {
  const auto complaint = [least, most](const std::string& text) {
    Number number{};
    const bool has_wrapped = std::is_unsigned_v<Number> && text.find('-') != text.npos;
    const bool is_number = !has_wrapped && CLI::detail::lexical_cast(text, number);
    if (is_number && number >= least && number <= most) return std::string();
    return fmt::format("{} is not a number from {} to {}", text, least, most);
  };
  return {complaint, CLI::Range(least, most).get_description()};
}

/// Adds options for the content of updates.
void add_body(CLI::App& app, BodySettings& body) {
  using Model = BodySettings::Model;
  using Payload = BodySettings::Payload;
  using Shape = World::Shape;
  take_words<Model>(
      app.add_option("--robot", body.model, "usual, or thesis: formula and tower as in the thesis"),
      {{"usual", Model::usual}, {"thesis", Model::thesis}});
  app.add_flag("--mirrored", body.is_mirrored,
               "With --robot thesis: pose and obstacles count angles differently");
  take_words<Shape>(
      app.add_option("--world", body.world, "ring of 160 cm, or room: an asymmetric one"),
      {{"ring", Shape::ring}, {"room", Shape::room}});
  app.add_flag("--stand", body.stands, "Robots stay where they start");
  take_words<Payload>(
      app.add_option("--payload", body.payload,
                     "positions, full (of the robots before the thesis), or probe"),
      {{"positions", Payload::positions}, {"full", Payload::full}, {"probe", Payload::probe}});
  app.add_option("--max-obstacles", body.max_obstacles, "Obstacles in one update")
      ->check(in_range(0U, 4U))
      ->capture_default_str();
  app.add_flag("--no-stray{false}", body.has_stray, "Without the octet that real robots append");
}

/// Adds options for the path between a robot and its gateway.
void add_hops(CLI::App& app, HopOptions& hop) {
  app.add_option("--hop-loss", hop.loss,
                 "Part of the transmissions that is lost on each hop, the robot's first: F[,F...]")
      ->delimiter(',')
      ->check(in_range(0.0, 1.0));
  app.add_option("--hop-delay-ms", hop.delay_ms,
                 "Mean time of a transmission on each hop: D[,D...]")
      ->delimiter(',')
      ->check(in_range(0.0, 60000.0));
}

void add_common(CLI::App& app, RobotOptions& options) {
  app.add_option("--robots", options.robots, "How many robots")
      ->check(in_range(1U, 10000U))
      ->capture_default_str();
  app.add_option("--rate", options.rate_hz, "Updates per second and robot")
      ->check(in_range(0.001, 1000.0))
      ->capture_default_str();
  app.add_option("--messages", options.messages,
                 "Updates per robot, then end (0: until SIGINT or SIGTERM)")
      ->check(in_range<std::uint64_t>(0, max_number))
      ->capture_default_str();
  app.add_option("--seed", options.seed, "Same seed, same robots, same payloads")
      ->check(in_range<std::uint64_t>(0, max_number))
      ->capture_default_str();
  app.add_option("--id-prefix", options.id_prefix, "Robots are called <prefix>1, <prefix>2, ...")
      ->capture_default_str();
  app.add_option("--loss", options.loss, "Part of the radio messages that is lost, each way")
      ->check(in_range(0.0, 1.0))
      ->capture_default_str();
  app.add_flag("--obey", options.obeys, "Let commands steer the robots (changes their payloads)");
  app.add_option("--linger-s", options.linger_s, "Stay this long after the last update")
      ->check(in_range(0.0, 86400.0))
      ->capture_default_str();
  app.add_option("--record", options.record,
                 "Write each update sent, each acknowledged and each command received");
  app.add_option("--trace", options.trace, "Write all that becomes of updates as JSON lines");
  add_body(app, options.body);
  add_hops(app, options.hop);
}

/// Adds options for actions of the client besides publishing.
void add_life(CLI::App& app, ThreadOptions& options) {
  app.add_option("--keep-alive", options.keep_alive_s, "Seconds between PINGREQs")
      ->check(in_range(1U, 65535U))
      ->capture_default_str();
  app.add_flag("--clean,!--no-clean", options.is_clean,
               "Begin with a clean session; --no-clean: with what the gateway has kept");
  app.add_option("--sleep", options.sleep_s,
                 "Sleep this many seconds at a time, waking early enough for repeats (0: never)")
      ->check(in_range(0U, 65535U))
      ->capture_default_str();
  app.add_option("--roam", options.roam_s, "Move to a new UDP port each so many seconds (0: never)")
      ->check(in_range(0.0, 86400.0))
      ->capture_default_str();
  app.add_option("--will-updates", options.will_updates_s,
                 "Change the will each so many seconds (0: never)")
      ->check(in_range(0.0, 86400.0))
      ->capture_default_str();
  app.add_option("--vanish", options.vanish,
                 "Part of the robots that ends without DISCONNECT, so that their wills appear")
      ->check(in_range(0.0, 1.0))
      ->capture_default_str();
}

void add_thread(CLI::App& app, ThreadOptions& options, std::string& gateway) {
  app.add_option("--gateway", gateway, "The MQTT-SN gateway: HOST:PORT or [ADDRESS]:PORT")
      ->required();
  add_common(app, options.common);
  app.add_option(
         "--qos", options.qos,
         "QoS of what robots publish; -1: without a session, robot n on pre-defined topic n")
      ->check(in_range(-1, 2))
      ->capture_default_str();
  app.add_option("--hops", options.hops, "Radio hops between each robot and the border router")
      ->check(in_range(1U, 16U))
      ->capture_default_str();
  app.add_option("--topic-prefix", options.topic_prefix, "First level(s) of the topic tree")
      ->capture_default_str();
  app.add_flag("--hear", options.hears, "Robots hear the updates of all others, and count them");
  app.add_option("--duplicate", options.duplicate, "Part of the datagrams that arrives twice")
      ->check(in_range(0.0, 1.0))
      ->capture_default_str();
  app.add_option("--reorder", options.reorder, "Part of the datagrams that is overtaken")
      ->check(in_range(0.0, 1.0))
      ->capture_default_str();
  app.add_option("--delay-ms", options.delay_ms, "Delay of each datagram, each way")
      ->check(in_range(0U, 60000U))
      ->capture_default_str();
  add_life(app, options);
  app.add_option("--retry", options.retry_s, "Seconds until a request is repeated")
      ->check(in_range(0.01, 3600.0))
      ->capture_default_str();
  app.add_option("--outstanding", options.outstanding,
                 "Requests without an answer at one time; the specification has 1")
      ->check(in_range(1U, 4U))
      ->capture_default_str();
  app.add_option("--give-up-s", options.give_up_s,
                 "Exit with status 1 when no robot got connected in this time (0: never)")
      ->check(in_range(0.0, 86400.0))
      ->capture_default_str();
}

struct BleTexts {
  std::string firmware = "3.1.0";
  std::string net_key = "000102030405060708090a0b0c0d0e0f";
  std::string app_key = "101112131415161718191a1b1c1d1e1f";
  std::string uuid_prefix = "736c616d";
  std::string static_oob;
};

void add_ble(CLI::App& app, BleOptions& options, BleTexts& texts) {
  app.add_option("--tty", options.ttys,
                 "Where to put the board's serial port (a symbolic link); several: as many boards, "
                 "which hear the same robots")
      ->required()
      ->delimiter(',')
      ->expected(1, max_boards);
  app.add_option("--board-loss", options.board_loss,
                 "Part of its messages that each board loses besides, each way")
      ->check(in_range(0.0, 1.0))
      ->delimiter(',');
  app.add_option("--board-level-db", options.board_level_db,
                 "How much better or worse than usual each board hears (RSSI)")
      ->check(in_range(-60, 60))
      ->delimiter(',');
  app.add_option("--board-fade", options.board_fade_s,
                 "Each board fades out and in once in so many seconds (0: never)")
      ->check(in_range(0.0, 3600.0))
      ->delimiter(',');
  add_common(app, options.common);
  app.add_option("--hops", options.hops, "Radio hops between each robot and the board")
      ->check(in_range(1U, 126U))
      ->capture_default_str();
  app.add_option("--firmware", texts.firmware,
                 "Release of the nRF5 SDK for Mesh that board and robots run")
      ->check(CLI::IsMember({"2.2.0", "3.1.0", "5.0.0"}))
      ->capture_default_str();
  app.add_flag("--acknowledged", options.is_acknowledged, "Robots use acknowledged messages (SET)");
  app.add_flag("--numbered", options.is_numbered,
               "With --acknowledged: messages have a transaction number (SET_NUMBERED)");
  app.add_flag("--unprovisioned", options.is_unprovisioned, "Robots wait to be provisioned");
  app.add_option("--uuid-prefix", texts.uuid_prefix,
                 "With --unprovisioned: how the robots' UUIDs begin, up to 24 hex digits")
      ->capture_default_str();
  app.add_option("--static-oob", texts.static_oob,
                 "With --unprovisioned: the robots demand this OOB value, 32 hex digits");
  app.add_flag("--heartbeats", options.has_heartbeats,
               "Heartbeat events each 10 s; with --firmware 5.0.0");
  app.add_option("--robot-reach", options.robot_reach,
                 "Robots stand in a row; each hears the heartbeats of N on either side")
      ->check(in_range(1U, 65535U))
      ->default_str("all");
  app.add_option("--state", options.state,
                 "Keep the flash of robots, and of a board with storage, in this file");
  app.add_flag("--unicast", options.is_unicast,
               "Robots publish to the board's unicast address instead of groups");
  app.add_flag("--segment-timing", options.has_segment_timing,
               "Segmented messages occupy their sender as long as on air");
  take_words<ble::OnBusy>(
      app.add_option("--on-busy", options.on_busy,
                     "What becomes of an update while a SET waits for its STATUS"),
      {{"cancel", ble::OnBusy::cancel}, {"refuse", ble::OnBusy::refuse}});
  app.add_option("--bearer-interval-ms", options.bearer_interval_ms,
                 "Least time between two packets of one node")
      ->check(in_range(0U, 1000U))
      ->capture_default_str();
  app.add_option("--baud", options.baud,
                 "Speed of the serial line, on which the board drops what it cannot say in time; "
                 "0: no limit")
      ->check(in_range(0U, 10000000U))
      ->capture_default_str();
  app.add_flag("--board-storage", options.has_board_storage,
               "The board keeps its tables and sequence number when it restarts");
  app.add_flag("--configured", options.is_configured,
               "The board starts as an earlier session left it: keys, address 0x0001, groups");
  app.add_option("--net-key", texts.net_key, "With --configured: network key, 32 hex digits")
      ->capture_default_str();
  app.add_option("--app-key", texts.app_key, "With --configured: application key, 32 hex digits")
      ->capture_default_str();
}

/// Throws CLI::ValidationError, as all checks below.
Bytes parse_hex(const std::string& option, const std::string& hex) {
  const bool is_hex =
      hex.size() % 2 == 0 &&
      std::all_of(hex.begin(), hex.end(), [](unsigned char c) { return std::isxdigit(c) != 0; });
  if (!is_hex) throw CLI::ValidationError(option, "pairs of hex digits are needed");
  Bytes key;
  for (std::size_t i = 0; i < hex.size(); i += 2) {
    key.push_back(static_cast<std::uint8_t>(std::stoul(hex.substr(i, 2), nullptr, 16)));
  }
  return key;
}

Bytes parse_key(const std::string& option, const std::string& hex) {
  if (hex.size() != 32) throw CLI::ValidationError(option, "32 hex digits are needed");
  return parse_hex(option, hex);
}

void check_common(const RobotOptions& options) {
  const std::string& prefix = options.id_prefix;
  const bool is_level = std::none_of(prefix.begin(), prefix.end(), [](unsigned char c) {
    return c <= ' ' || c == 0x7f || c == '+' || c == '#' || c == '/';
  });
  if (!is_level) {
    throw CLI::ValidationError("--id-prefix", "no spaces, control characters, '+', '#' or '/'");
  }
  if (options.id_of(options.robots).size() > max_client_id) {
    throw CLI::ValidationError("--id-prefix", "ids must not be longer than 23 characters");
  }
}

void split_gateway(const std::string& gateway, ThreadOptions& options) {
  const std::size_t colon = gateway.rfind(':');
  if (colon == std::string::npos) throw CLI::ValidationError("--gateway", "HOST:PORT is needed");
  options.host = gateway.substr(0, colon);
  options.port = gateway.substr(colon + 1);
  const bool has_brackets =
      options.host.size() > 2 && options.host.front() == '[' && options.host.back() == ']';
  if (has_brackets) options.host = options.host.substr(1, options.host.size() - 2);
  const bool is_number = !options.port.empty() && options.port.size() <= 5 &&
                         options.port.find_first_not_of("0123456789") == std::string::npos;
  if (!is_number || std::stoul(options.port) == 0 || std::stoul(options.port) > 65535) {
    throw CLI::ValidationError("--gateway", "the port must be a number from 1 to 65535");
  }
  if (options.host.empty() || (!has_brackets && options.host.find(':') != std::string::npos)) {
    throw CLI::ValidationError("--gateway", "HOST:PORT is needed; IPv6 addresses in brackets");
  }
}

BleOptions finish_ble(BleOptions options, const BleTexts& texts) {
  check_common(options.common);
  options.firmware = ble::find_firmware(texts.firmware);
  if (options.has_heartbeats && !options.firmware->has_heartbeats) {
    throw CLI::ValidationError("--heartbeats", "needs --firmware 5.0.0");
  }
  if (options.ttys.size() > 1 && !options.state.empty()) {
    throw CLI::ValidationError("--state", "keeps one board only");
  }
  options.net_key = parse_key("--net-key", texts.net_key);
  options.app_key = parse_key("--app-key", texts.app_key);
  options.uuid_prefix = parse_hex("--uuid-prefix", texts.uuid_prefix);
  if (options.uuid_prefix.size() > max_uuid_prefix) {
    throw CLI::ValidationError("--uuid-prefix", "at most 24 hex digits");
  }
  if (!texts.static_oob.empty()) options.static_oob = parse_key("--static-oob", texts.static_oob);
  return options;
}

}  // namespace

CommandLine parse_command_line(int argc, const char* const* argv) {
  CLI::App app{"Simulated robots on a simulated mesh, for people without hardware."};
  app.set_version_flag("--version", "slam-gateway-sim " SLAMGW_VERSION);
  app.require_subcommand(1);
  ThreadOptions thread;
  std::string gateway;
  add_thread(*app.add_subcommand("thread", "Robots on Thread, as MQTT-SN clients"), thread,
             gateway);
  BleOptions ble;
  ble.baud = default_baud;
  BleTexts texts;
  add_ble(*app.add_subcommand("ble", "A Nordic serial board with robots on BLE Mesh behind it"),
          ble, texts);
  try {
    app.parse(argc, argv);
    if (app.got_subcommand("ble")) return finish_ble(ble, texts);
    check_common(thread.common);
    split_gateway(gateway, thread);
    return thread;
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);
    fmt::print(stderr, "slam-gateway-sim: {}\nRun with --help for more information.\n",
               error.what());
    return wrong_arguments;
  }
}

}  // namespace slamgw::sim

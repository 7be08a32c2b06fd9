// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/checks.hpp"

#include <fmt/format.h>
#include <sys/un.h>

namespace slamgw {
namespace {

/// Reports each repetition of a value. `what` completes "is ... already".
template <class T>
class Unique {
 public:
  Unique(const Located& located, std::string what) : located_(located), what_(std::move(what)) {}

  void add(const T& value, const std::string& key) {
    const auto [first, is_new] = first_.emplace(value, key);
    if (!is_new)
      located_.problem(
          key, fmt::format("is {} of {} already; each once is allowed", what_, first->second));
  }

 private:
  const Located& located_;
  std::string what_;
  std::map<T, std::string> first_;
};

void require(const Located& located, const std::string& group, std::string_view key) {
  const std::string path = fmt::format("{}.{}", group, key);
  if (!located.is_set(path))
    located.problem(path, fmt::format("is missing; \"{}\" is needed", key));
}

void check_robots(const Located& located) {
  Unique<std::string> ids(located, "the id");
  Unique<std::uint16_t> addresses(located, "the address");
  Unique<std::string> client_ids(located, "the client id");
  const Config& config = located.config;
  if (config.ble_mesh.enabled) addresses.add(config.ble_mesh.address, "ble_mesh.address");
  for (std::size_t i = 0; i < config.robots.size(); ++i) {
    const RobotName& robot = config.robots[i];
    const std::string path = fmt::format("robots[{}]", i);
    require(located, path, "id");
    if (!robot.id.empty()) ids.add(robot.id, path + ".id");
    const auto implied = RobotNames().ble_address_of(robot.id);
    if (implied && implied != robot.ble_address)
      located.problem(path + ".id",
                      fmt::format("is the name of the BLE robot at 0x{:04x}; another id, or that "
                                  "ble_address, is needed",
                                  *implied));
    if (robot.ble_address) addresses.add(*robot.ble_address, path + ".ble_address");
    if (robot.mqttsn_client_id) client_ids.add(*robot.mqttsn_client_id, path + ".mqttsn_client_id");
    if (robot.address && robot.ble_address && !robot.mqttsn_client_id)
      located.problem(path + ".address",
                      "is an address on Thread, where this robot has no name; "
                      "\"mqttsn_client_id\" is needed too");
    if (robot.prefer && (!robot.ble_address || !robot.mqttsn_client_id))
      located.problem(path + ".prefer",
                      "is for a robot on both meshes; \"ble_address\" and \"mqttsn_client_id\" are "
                      "needed");
    if (!located.is_set(path + ".ble_address") && !located.is_set(path + ".mqttsn_client_id") &&
        !located.is_set(path + ".origin") && !located.is_set(path + ".address"))
      located.problem(path,
                      "has no address; \"ble_address\", \"mqttsn_client_id\" or both are "
                      "needed");
  }
}

void check_predefined_topics(const Located& located) {
  using Scope = std::pair<std::optional<std::string>, std::uint16_t>;
  Unique<Scope> ids(located, "the id");
  const auto& topics = located.config.mqttsn.predefined_topics;
  for (std::size_t i = 0; i < topics.size(); ++i) {
    const std::string path = fmt::format("mqttsn.predefined_topics[{}]", i);
    require(located, path, "id");
    require(located, path, "name");
    if (topics[i].id != 0) ids.add({topics[i].client_id, topics[i].id}, path + ".id");
  }
}

void check_ble_mesh(const Located& located) {
  const ble::Settings& ble = located.config.ble_mesh;
  if (ble.will) {
    require(located, "ble_mesh.will", "topic");
    require(located, "ble_mesh.will", "message");
  }
  if (ble.pos_cmd_type == "run")
    located.problem("ble_mesh.types.pos_cmd",
                    "\"run\" is the type of on/off commands; any other type is allowed");
  if (ble.gateway_group && std::ranges::find(ble.groups, *ble.gateway_group) != ble.groups.end())
    located.problem("ble_mesh.gateway_group",
                    "is in ble_mesh.groups, to which robots are subscribed: they would acknowledge "
                    "each other's messages; any other group is allowed");
  if (ble.radio == ble::RadioChoice::bluez && ble.protocol == ble::Protocol::cobs)
    located.problem("ble_mesh.protocol",
                    "is for a serial board, and \"radio\" is \"bluez\"; only \"nordic-serial\" is "
                    "allowed beside it");
  const bool is_positions_stream =
      ble.protocol == ble::Protocol::cobs && ble.cobs_content == ble::CobsContent::positions;
  if (is_positions_stream && !located.is_set("ble_mesh.robot_id"))
    located.problem("ble_mesh.robot_id",
                    "is missing: this stream does not say whose positions it carries; with "
                    "\"protocol\": \"cobs\" and \"cobs_content\": \"positions\" a robot's id is "
                    "needed");
}

void check_relay(const Located& located) {
  const ble::Settings& ble = located.config.ble_mesh;
  if (ble.relay.empty()) return;
  if (ble.protocol == ble::Protocol::cobs)
    located.problem("ble_mesh.relay",
                    "has no effect on this link, which has no way to robots; only \"protocol\": "
                    "\"nordic-serial\" is allowed beside it");
  if (located.config.update_mode == UpdateMode::json)
    located.problem(
        "ble_mesh.relay",
        "would carry JSON, which robots do not understand; \"positions\" or \"raw\" for "
        "payload.update is allowed beside it");
  if (ble.relay.size() > 1 && std::ranges::find(ble.relay, "robot/+/update") != ble.relay.end())
    located.problem("ble_mesh.relay",
                    "names robots beside \"robot/+/update\", which has all of them: each update "
                    "would come twice; that filter alone is allowed");
  if (ble.gateway_group == ble.relay_group ||
      std::ranges::find(ble.groups, ble.relay_group) != ble.groups.end())
    located.problem("ble_mesh.relay_group",
                    "is ble_mesh.gateway_group or in ble_mesh.groups, which gateways hear; any "
                    "other group is allowed");
}

void check_mqttsn(const Located& located) {
  const mqttsn::Settings& mqttsn = located.config.mqttsn;
  if (mqttsn.enabled && mqttsn.listen.empty())
    located.problem("mqttsn.listen",
                    "is empty; at least one address, or \"enabled\": false, is needed");
  if (mqttsn.dtls.keys_file && mqttsn.dtls.listen.empty())
    located.problem("mqttsn.dtls.listen",
                    "is empty; at least one address is needed beside keys_file");
  if (!mqttsn.enabled || !mqttsn.announce) return;
  if (mqttsn.is_auto() || mqttsn.interface == "lo" || mqttsn::is_thread_interface(mqttsn.interface))
    located.problem("mqttsn.announce",
                    fmt::format("has no effect on the LAN, which mqttsn.interface \"{}\" may not "
                                "serve; \"*\" or the name of the LAN's interface is needed there",
                                mqttsn.interface));
  if (mqttsn.require_identity == mqttsn::RequireIdentity::all)
    located.problem(
        "mqttsn.announce",
        "announces the port of plain MQTT-SN, which mqttsn.require_identity \"all\" closes; "
        "false is allowed beside it");
  if (!mqttsn.listens_widely())
    located.problem("mqttsn.announce",
                    "needs an address such as [::]:47193 or 0.0.0.0:47193 in mqttsn.listen");
}

void check_tls_keys(const Located& located) {
  const BrokerSettings& broker = located.config.broker;
  for (const auto& [key, file] : {std::pair{"ca_file", &broker.ca_file},
                                  std::pair{"certificate_file", &broker.certificate_file},
                                  std::pair{"key_file", &broker.key_file}}) {
    if (*file && !broker.uses_tls())
      located.problem(fmt::format("broker.tls.{}", key),
                      "has no effect without TLS; a broker.uri with mqtts:// is needed");
  }
  if (broker.certificate_file.has_value() == broker.key_file.has_value()) return;
  located.problem(broker.key_file ? "broker.tls.key_file" : "broker.tls.certificate_file",
                  "stands alone; certificate_file and key_file are allowed only together");
}

void check_control_socket(const Located& located) {
  constexpr std::size_t longest = sizeof(sockaddr_un::sun_path) - 1;
  if (located.config.control_socket.size() > longest)
    located.problem("control.socket",
                    fmt::format("is too long for a socket; {} bytes are allowed", longest));
}

enum class TlsFile : std::uint8_t { certificate, key };

/// The PEM text when the file is good; nothing when it is not set or a problem was reported.
std::optional<std::string> checked_text(const Located& located, const Files& files,
                                        const std::string& key,
                                        const std::optional<std::string>& path, TlsFile kind) {
  if (!path) return std::nullopt;
  const auto file = files.read(*path);
  if (!file) {
    located.problem(key, fmt::format("{} cannot be read: {}; a readable PEM file is needed", *path,
                                     file.error().text));
    return std::nullopt;
  }
  const std::string fault = kind == TlsFile::certificate ? files.certificate_fault(file->text)
                                                         : files.key_fault(file->text);
  if (fault.empty()) return file->text;
  located.problem(
      key, fmt::format(
               "{} {}; a {} as PEM is needed", *path, fault,
               kind == TlsFile::certificate ? "certificate" : "private key without pass phrase"));
  return std::nullopt;
}

}  // namespace

Place Located::place_of(std::string key) const {
  while (true) {
    if (const auto found = places.find(key); found != places.end()) return found->second;
    const std::size_t dot = key.rfind('.');
    if (dot == std::string::npos) return {context.file, 1};
    key.resize(dot);
  }
}

void Located::problem(const std::string& key, std::string text) const {
  const Place place = place_of(key);
  context.problems.push_back({place.file, place.line, key, std::move(text)});
}

void check_relations(const Located& located) {
  check_robots(located);
  check_predefined_topics(located);
  check_ble_mesh(located);
  check_relay(located);
  check_mqttsn(located);
  check_tls_keys(located);
  check_control_socket(located);
}

void warn_of_relations(const Located& located, Problems& warnings) {
  const ble::Settings& ble = located.config.ble_mesh;
  if (!ble.enabled || ble.protocol != ble::Protocol::nordic_serial) return;
  if (ble.offline_after > ble::health_interval) return;
  const std::string key = "presence.offline_after_s";
  const Place place = located.place_of(key);
  warnings.push_back(
      {place.file, place.line, key,
       fmt::format(
           "is no longer than the {} s between two health messages of a BLE robot: a "
           "robot that sends nothing else goes offline and online again each time; more than {} "
           "is needed, the default is {}",
           ble::health_interval.count(), ble::health_interval.count(),
           ble::Settings{}.offline_after.count())});
}

void check_tls_files(const Located& located, const Files& files) {
  const BrokerSettings& broker = located.config.broker;
  checked_text(located, files, "broker.tls.ca_file", broker.ca_file, TlsFile::certificate);
  const auto certificate = checked_text(located, files, "broker.tls.certificate_file",
                                        broker.certificate_file, TlsFile::certificate);
  const auto key =
      checked_text(located, files, "broker.tls.key_file", broker.key_file, TlsFile::key);
  if (certificate && key && !files.key_matches(*certificate, *key))
    located.problem("broker.tls.key_file",
                    "does not belong to certificate_file; its own private key is needed");
}

}  // namespace slamgw

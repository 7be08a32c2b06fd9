// SPDX-License-Identifier: Apache-2.0
// slam-gatewayctl's arguments as a request to the daemon.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <variant>

#include "ctl/connection.hpp"
#include "ctl/show.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ctl {

/// How a command goes on: most ask once and show the answer.
enum class Course : std::uint8_t {
  once,
  ping,  ///< `count` times, once a second
  watch,
  record,  ///< watch events into `file`
  send,    ///< its outcome is the exit status
  scan,
  joining,  ///< asked again and again until nobody joins any more
  nodes,
  topology,      ///< of `ble nodes` and `robots` together
  hearing,       ///< asked again and again until it is measured
  dead_letters,  ///< page by page, as a table
  exported,      ///< page by page, a JSON document a line
  mesh,          ///< into a file
  resent,
  discarded,
};

struct Order {
  std::string socket = "/run/slam-gateway/control.sock";
  bool json = false;
  Course course = Course::once;
  /// The answer for people; null where another function writes it (dead letters).
  std::string (*text)(const nlohmann::json& answer, const Screen& screen) = nullptr;
  std::chrono::seconds patience = answer_patience;
  nlohmann::json request;
  std::uint64_t count = 1;
  std::string file;  ///< whose text goes with the request as `text`, or that gets the answer's
};

/// What slam-gatewayctl does by itself, on the host that the gateway runs on.
struct HostTask {
  enum class Kind : std::uint8_t {
    backup,
    restore,
    report,
    doctor,
    replay,
    ban,
    unban,
    audit,
    key_add,
    key_list,
    key_remove,
    check,
  };
  Kind kind = Kind::doctor;
  std::string socket = Order{}.socket;
  bool json = false;
  std::string configuration = "/etc/slam-gateway/gateway.json";
  /// Another gateway than this host's service: its daemon says what its configuration is.
  bool is_by_socket = false;
  std::string file;           ///< the archive or the recording; none for doctor
  std::string robot;          ///< of check, doctor and audit; empty: the whole way, all
  std::uint64_t minutes = 1;  ///< of check
  std::string who;            ///< of ban and unban: an entry of `bans`; of key: a robot
  std::string broker;         ///< of replay; empty: the one of the configuration
  std::string user;           ///< of replay, at the broker; empty: as the daemon
  double speed = 1;           ///< of replay
  bool is_confirmed = false;  ///< of restore: do not ask
};

struct Exit {
  int status = 0;
};

/// Prints help, the version, or what is wrong with the arguments (status 2) itself.
std::variant<Order, HostTask, Exit> parse_command_line(int argc, const char* const* argv);

/// The PAYLOAD of `send`. With `is_hex` pairs of hex digits; for `cmd` else `X,Y` as two
/// little-endian int16, centimetres (docs/topics.md); else the text itself. The error says what is
/// allowed.
Result<Bytes, std::string> parse_payload(std::string_view type, std::string_view text, bool is_hex);

}  // namespace slamgw::ctl

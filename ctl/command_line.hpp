// SPDX-License-Identifier: Apache-2.0
// Parses slam-gatewayctl's arguments into a request to the daemon or a task on this host.
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

/// How a command proceeds: most commands ask once and show the answer.
enum class Course : std::uint8_t {
  once,
  ping,  ///< asks `count` times, once a second
  watch,
  record,  ///< writes watch events to `file`
  send,    ///< the command's outcome is the exit status
  scan,
  joining,  ///< asks again until joining has ended
  nodes,
  topology,      ///< combines `ble nodes` and `robots`
  hearing,       ///< asks again until the measurement has ended
  dead_letters,  ///< page by page, as a table
  exported,      ///< page by page, a JSON document a line
  mesh,          ///< writes the mesh to `file`
  resent,
  discarded,
};

struct Order {
  std::string socket = "/run/slam-gateway/control.sock";
  bool json = false;
  Course course = Course::once;
  /// Makes the text of an answer for people; null where another function does (dead letters).
  std::string (*text)(const nlohmann::json& answer, const Screen& screen) = nullptr;
  std::chrono::seconds patience = answer_patience;
  nlohmann::json request;
  std::uint64_t count = 1;
  std::string file;  ///< its text is sent as `text`, or it gets the answer
};

/// A task that slam-gatewayctl performs by itself, on the gateway's host.
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
  /// Asks the daemon at `socket`, which may not be this host's service, for its configuration.
  bool is_by_socket = false;
  std::string file;           ///< the archive or the recording; none for doctor
  std::string robot;          ///< for check, doctor and audit; empty: the whole way, all robots
  std::uint64_t minutes = 1;  ///< for check
  std::string who;            ///< for ban and unban: an entry of `bans`; for key: a robot
  std::string broker;         ///< for replay; empty: the configuration's
  std::string user;           ///< for replay, at the broker; empty: the daemon's
  double speed = 1;           ///< for replay
  bool is_confirmed = false;  ///< for restore: do not ask
};

struct Exit {
  int status = 0;
};

/// Prints help, the version, or a fault in the arguments (status 2) itself.
std::variant<Order, HostTask, Exit> parse_command_line(int argc, const char* const* argv);

/// Parses the PAYLOAD of `send`: with `is_hex`, pairs of hex digits. Otherwise `cmd` takes `X,Y` in
/// centimetres and gets two little-endian int16 (docs/topics.md); other types get the text itself.
/// The error says what is allowed.
Result<Bytes, std::string> parse_payload(std::string_view type, std::string_view text, bool is_hex);

}  // namespace slamgw::ctl

// SPDX-License-Identifier: Apache-2.0
// The events of each update at its robot and of received commands, and the files that `--record`
// and
// `--trace` make of them, so that tests and experiments can compare them with arriving messages.
#pragma once

#include <cstdint>
#include <fstream>
#include <string>
#include <string_view>

#include "simulation/bytes.hpp"

namespace slamgw::sim {

struct UpdateEvent {
  enum class Kind : std::uint8_t {
    sent,           ///< for the first time
    acknowledged,   ///< PUBACK, PUBCOMP or STATUS seen
    repeated,       ///< sent again by the client
    refused,        ///< never sent: the client or the transport is busy, or the queue is full
    cancelled,      ///< without its STATUS, by the next update
    given_up,       ///< after all repeats
    link_repeated,  ///< a frame of it on one hop, without an 802.15.4 acknowledgement
    command,        ///< the robot received a command, perhaps a repeated one
    heard,          ///< another robot's update
  };
  Kind kind = Kind::sent;
  std::uint64_t number = 0;  ///< counts the robot's updates from 1; of a command: its message id
  Bytes payload{};           ///< sent, refused or received; else empty
  std::string_view type{};   ///< of a command
  std::string sender{};      ///< of a heard update: its id, on BLE its number

  bool is_acknowledged() const { return kind == Kind::acknowledged; }
};

/// Each line is in its file as soon as the event has happened.
class UpdateRecord {
 public:
  /// `record`: sent and acknowledged, `sent <id> <number> <payload in hex> <seconds since 1970>`
  /// and `acknowledged <id> <number> <seconds since 1970>`; and for each command that reaches a
  /// robot `received <id> <message id> <type> <payload in hex> <seconds since 1970>`, for each
  /// update of another robot `heard <id> <sender> <payload in hex> <seconds since 1970>`. `trace`:
  /// all of its own updates, a JSON object a line, with the members of
  /// `slam-gatewayctl --json watch`. No path, no file. Throws std::runtime_error when one can't be
  /// written.
  UpdateRecord(const std::string& record, const std::string& trace, std::string_view mesh);

  /// Throws std::runtime_error with file and reason when a line can't be written.
  void write(const std::string& id, const UpdateEvent& event);

 private:
  void write_record(const std::string& id, const UpdateEvent& event, std::int64_t since_1970_us);
  void write_trace(const std::string& id, const UpdateEvent& event, std::int64_t since_1970_us);

  std::ofstream record_;
  std::ofstream trace_;
  std::string record_path_;
  std::string trace_path_;
  std::string mesh_;
};

}  // namespace slamgw::sim

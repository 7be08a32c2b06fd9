// SPDX-License-Identifier: Apache-2.0
// Records each update and its acknowledgement, so that a test can compare them with what arrives at
// the broker: the events that robots leave, and the file that `--record` makes of them.
#pragma once

#include <cstdint>
#include <fstream>
#include <string>

#include "simulation/bytes.hpp"

namespace slamgw::sim {

struct UpdateEvent {
  bool is_acknowledged;  ///< else it was sent, for the first time
  std::uint64_t number;  ///< counts the robot's updates from 1
  Bytes payload;         ///< of what was sent; else empty
};

/// One line an event, in the file as soon as it has happened:
/// `sent <id> <number> <payload in hex> <seconds since 1970>` or
/// `acknowledged <id> <number> <seconds since 1970>`.
class UpdateRecord {
 public:
  /// No path, no record. Throws std::runtime_error when the file can't be written.
  explicit UpdateRecord(const std::string& path);

  void write(const std::string& id, const UpdateEvent& event);

 private:
  std::ofstream file_;
};

}  // namespace slamgw::sim

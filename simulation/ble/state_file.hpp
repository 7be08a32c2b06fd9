// SPDX-License-Identifier: Apache-2.0
// State that survives the simulator's process (--state): the flash of the robots, and of a board
// with storage, as one JSON document. It holds keys, so only its owner can read the file.
#pragma once

#include <string>

#include "simulation/ble/network.hpp"

namespace slamgw::sim::ble {

/// Sequence numbers are written some thousands ahead, as the firmware reserves them in blocks: the
/// text changes seldom, and no number is used twice after a crash.
std::string state_of(const Network& network);

/// Call before the network starts. Throws std::runtime_error for a text that `state_of` did not
/// make.
void restore_state(Network& network, const std::string& text);

/// Returns "" when there is no such file. Throws std::system_error.
std::string read_state(const std::string& path);
/// Replaces the file atomically: a reader or a crash finds the old text or the new one. Throws
/// std::system_error.
void write_state(const std::string& path, const std::string& text);

}  // namespace slamgw::sim::ble

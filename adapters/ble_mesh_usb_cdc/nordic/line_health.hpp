// SPDX-License-Identifier: Apache-2.0
// Decides whether a serial line is usable: counts what goes wrong on it and names the likely cause.
// Nothing protects the octets on that line, so octets that are lost or added show only as torn
// frames, refusals of commands that were never sent, and answers that do not come. Called by
// BoardLink.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "daemon/core/time.hpp"

namespace slamgw::ble {

class LineHealth {
 public:
  /// After so many losses in a row the line counts as unusable.
  static constexpr int max_losses = 8;
  /// From so many in a row on, the operator gets a warning.
  static constexpr int noticeable_losses = 3;
  /// A loss that comes later than this after the one before begins a new row.
  static constexpr Duration stable_time = std::chrono::seconds{10};
  /// So many unanswered commands of one kind in a row are no accident.
  static constexpr int max_timeouts = 3;

  void on_port_open();
  /// Octets were lost or added: a torn frame, or one that the board did not understand.
  void on_lost_step(TimePoint now);
  void on_timeout(std::uint8_t opcode, TimePoint now);
  /// A command was answered.
  void on_answer(std::uint8_t opcode);

  int losses() const { return losses_; }
  /// Why the port should be closed; nothing while the line is usable.
  std::optional<std::string> verdict() const;
  /// When the last loss is so long ago that the line counts as good.
  TimePoint stable_at() const { return last_loss_ + stable_time; }

 private:
  void count(TimePoint now);

  int losses_ = 0;
  bool has_lost_step_ = false;  ///< since the port was opened
  TimePoint last_loss_{};
  std::uint8_t silent_opcode_ = 0;  ///< the command that was not answered last
  int timeouts_ = 0;                ///< of that one, in a row
};

}  // namespace slamgw::ble

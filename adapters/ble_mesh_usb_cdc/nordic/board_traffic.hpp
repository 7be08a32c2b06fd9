// SPDX-License-Identifier: Apache-2.0
// The messages to robots through a started board, in two queues. Makes a handle for each
// destination when it is needed. Has no timing: a command is followed by its response, then by the
// next command. Called by BoardRadio.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <variant>

#include "adapters/ble_mesh_usb_cdc/nordic/serial_protocol.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/start_up.hpp"
#include "daemon/core/protocol_machine.hpp"

namespace slamgw::ble {

class BoardTraffic {
 public:
  /// Messages waiting in each queue: 32 take about a second at 115200 baud.
  static constexpr std::size_t max_queued = 32;

  /// `actions` is BoardRadio's and must outlive this object.
  BoardTraffic(std::uint8_t ttl, ActionQueue<RadioAction>& actions)
      : ttl_(ttl), actions_(actions) {}

  /// Call also when the link only got in step again. Waiting messages stay.
  void on_started(const StartedBoard& board);
  /// Drops all messages.
  void on_link_down();

  /// Returns false if the queue is full.
  bool send(Outgoing message);
  void withdraw(std::uint16_t destination, const Bytes& payload);
  bool is_idle() const { return urgent_.empty() && normal_.empty(); }

  /// Returns the frame to write now, if any; then on_response() or on_answer_lost() must follow.
  /// While `is_holding`, messages that are not urgent wait.
  std::optional<Bytes> next(bool is_holding);
  bool awaits_response() const { return purpose_ != Purpose::none; }
  void on_response(const CommandResponse& response);
  void on_answer_lost() { purpose_ = Purpose::none; }

  /// Returns the board that was started up last.
  const StartedBoard& board() const { return board_; }
  std::uint64_t sent() const { return sent_; }
  std::uint64_t refused() const { return refused_; }

 private:
  /// The purpose of the command that awaits its response.
  enum class Purpose : std::uint8_t { none, message, add_handle, check_handle, remove_handle };

  std::deque<Outgoing>& next_queue() { return urgent_.empty() ? normal_ : urgent_; }
  Bytes next_message();
  void on_handle_added(const CommandResponse& response);
  void on_handle_checked(const CommandResponse& response);
  void on_sent(const CommandResponse& response);
  void erase_messages(const auto& is_meant);
  void refuse(std::uint16_t destination, std::string why);

  std::uint8_t ttl_;
  ActionQueue<RadioAction>& actions_;
  std::uint64_t sent_ = 0;
  std::uint64_t refused_ = 0;
  StartedBoard board_;
  std::deque<Outgoing> urgent_;
  std::deque<Outgoing> normal_;
  Purpose purpose_ = Purpose::none;
  std::uint16_t destination_ = 0;                 ///< of the message that the last command was for
  std::optional<std::uint16_t> handle_to_check_;  ///< of `destination_`
};

}  // namespace slamgw::ble

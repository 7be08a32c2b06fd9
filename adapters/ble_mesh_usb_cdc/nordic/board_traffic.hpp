// SPDX-License-Identifier: Apache-2.0
// The traffic to a started board: messages to robots, in two queues, and BoardRadio's commands.
// Makes a handle for each destination when it is needed. Has no timing: a command is followed by
// its response, then by the next command. Called by BoardLink.
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

/// The command that was given to `BoardLink::command` has ended.
struct CommandEnded : CommandResponse {
  bool is_repeat = false;  ///< the first answer was lost: the board may have obeyed then
};

using LinkAction = std::variant<WriteSerial, ReopenPort, GenerateKeys, SourceWanted, LinkIsUp,
                                LinkIsDown, SendRefused, MessageReceived, Heartbeat, IvUpdate,
                                ProvisioningEvent, CommandEnded, RadioCleared, Notice>;

struct LinkCounters {
  std::uint64_t resyncs = 0;   ///< attempts to get in step, the first after opening included
  std::uint64_t restarts = 0;  ///< the board's own
  std::uint64_t command_timeouts = 0;
  std::uint64_t malformed_events = 0;
  std::uint64_t other_events = 0;  ///< not used here, whether the protocol has them or not
  std::uint64_t board_drops = 0;   ///< events lost inside the board (command 0x14)
  std::uint64_t sent = 0;
  std::uint64_t send_refused = 0;
  std::uint64_t sends_dropped = 0;  ///< not taken: the link was down or the queue full
  std::uint64_t tx_complete = 0;
};

class BoardTraffic {
 public:
  /// Messages waiting in each queue: 32 take about a second at 115200 baud.
  static constexpr std::size_t max_queued = 32;

  /// `actions` and `counters` are BoardLink's and must outlive this object.
  BoardTraffic(std::uint8_t ttl, ActionQueue<LinkAction>& actions, LinkCounters& counters)
      : ttl_(ttl), actions_(actions), counters_(counters) {}

  /// Call also when the link only got in step again. Waiting messages stay.
  void on_started(const StartedBoard& board);
  /// Drops all messages and the command.
  void on_link_down();
  /// The link lost step: the answer to the last command will not come.
  void on_answer_lost();

  /// See BoardLink's functions of the same names. send() returns false if the queue is full.
  bool send(Outgoing message);
  void withdraw(std::uint16_t destination, const Bytes& payload);
  bool command(Bytes frame);
  bool is_idle() const { return urgent_.empty() && normal_.empty() && !command_; }

  /// Returns the frame to write now, if any; then on_response() or on_answer_lost() must follow.
  /// While `is_holding`, messages that are not urgent wait.
  std::optional<Bytes> next(bool is_holding);
  void on_response(const CommandResponse& response);

  const StartedBoard& board() const { return board_; }

 private:
  /// The purpose of the command that awaits its response.
  enum class Purpose : std::uint8_t {
    none,
    command,
    message,
    add_handle,
    check_handle,
    remove_handle
  };

  std::deque<Outgoing>& next_queue() { return urgent_.empty() ? normal_ : urgent_; }
  Bytes next_message();
  Bytes remove_handle(std::uint16_t handle);
  void on_handle_added(const CommandResponse& response);
  void on_handle_checked(const CommandResponse& response);
  void on_sent(const CommandResponse& response);
  void erase_messages(const auto& is_meant);
  void refuse(std::uint16_t destination, std::string why);

  std::uint8_t ttl_;
  ActionQueue<LinkAction>& actions_;
  LinkCounters& counters_;
  StartedBoard board_;
  std::deque<Outgoing> urgent_;
  std::deque<Outgoing> normal_;
  std::optional<Bytes> command_;  ///< until its answer is there
  bool is_command_repeated_ = false;
  Purpose purpose_ = Purpose::none;
  std::uint16_t destination_ = 0;                 ///< of the message that the last command was for
  std::optional<std::uint16_t> handle_to_check_;  ///< of `destination_`
  std::optional<std::uint16_t> handle_to_remove_;
};

}  // namespace slamgw::ble

// SPDX-License-Identifier: Apache-2.0
// What a started board is to send: messages to robots, in two queues, and the provisioner's
// commands. Makes a handle for each destination when it is needed. No timing: the next command, its
// response, the next. Called by BoardLink.
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

/// How the command that was given to `BoardLink::command` ended.
struct CommandEnded : CommandResponse {
  bool is_repeat = false;  ///< its first answer was lost: the board may have done it then
};

using LinkAction = std::variant<WriteSerial, ReopenPort, GenerateKeys, SourceWanted, LinkIsUp,
                                LinkIsDown, SendRefused, MessageReceived, Heartbeat, IvUpdate,
                                ProvisioningEvent, CommandEnded, RadioCleared, Notice>;

struct LinkCounters {
  std::uint64_t resyncs = 0;   ///< attempts to get in step, the first after opening included
  std::uint64_t restarts = 0;  ///< the board's own
  std::uint64_t command_timeouts = 0;
  std::uint64_t malformed_events = 0;
  std::uint64_t other_events = 0;  ///< known to the protocol or not, not used here
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

  /// `actions` and `counters` are BoardLink's and outlive it.
  BoardTraffic(std::uint8_t ttl, ActionQueue<LinkAction>& actions, LinkCounters& counters)
      : ttl_(ttl), actions_(actions), counters_(counters) {}

  /// Also when the link only got in step again; waiting messages stay.
  void on_started(const StartedBoard& board);
  /// Forgets what waits.
  void on_link_down();
  /// The link lost step: the answer to the last command will not come.
  void on_answer_lost();

  /// BoardLink's functions of the same names.
  bool send(Outgoing message);
  void withdraw(std::uint16_t destination, const Bytes& payload);
  bool command(Bytes frame);
  bool is_idle() const { return urgent_.empty() && normal_.empty() && !command_; }

  /// The frame to write now, if any; then its response or on_answer_lost. `is_holding`: messages
  /// that are not urgent wait.
  std::optional<Bytes> next(bool is_holding);
  void on_response(const CommandResponse& response);

  const StartedBoard& board() const { return board_; }

 private:
  /// What the response is for.
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

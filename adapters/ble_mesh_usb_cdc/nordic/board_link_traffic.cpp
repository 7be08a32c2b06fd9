// SPDX-License-Identifier: Apache-2.0
// What goes over BoardLink: the board's events, and one command in flight to it.
#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/nordic/board_link.hpp"

namespace slamgw::ble {
namespace {

constexpr bool is_opcode(std::uint8_t octet, CommandOpcode opcode) {
  return octet == static_cast<std::uint8_t>(opcode);
}

}  // namespace

// --- What is to be sent --------------------------------------------------------------------------

bool BoardLink::send(Outgoing message, TimePoint now) {
  if (message.is_urgent) withdraw(message.destination, message.payload);
  if (!is_up_ || urgent_.size() + normal_.size() >= max_queued) return false;
  if (message.payload.size() > send_limit(version_)) {
    refuse_send(
        message.destination,
        fmt::format("{} octets are too many: the board's firmware (serial protocol version "
                    "{}) sends at most {}",
                    message.payload.size(), static_cast<unsigned>(version_), send_limit(version_)));
    return true;
  }
  (message.is_urgent ? urgent_ : normal_).push_back(std::move(message));
  send_next(now);
  return true;
}

void BoardLink::withdraw(std::uint16_t destination, const Bytes& payload) {
  std::erase_if(urgent_, [&](const Outgoing& message) {
    return message.destination == destination && message.payload == payload;
  });
}

bool BoardLink::command(Bytes frame, TimePoint now) {
  if (!is_up_ || command_) return false;
  command_ = std::move(frame);
  is_command_repeated_ = false;
  send_next(now);
  return true;
}

bool BoardLink::clear_board(TimePoint now) {
  if (stage_ != Stage::running && stage_ != Stage::refused) return false;
  is_clear_wanted_ = true;
  if (stage_ == Stage::running) {
    send_next(now);
  } else {
    issue_clear(now);
  }
  return true;
}

bool BoardLink::issue_clear(TimePoint now) {
  if (!is_clear_wanted_ || in_flight_) return false;
  issue(encode_command(CommandOpcode::state_clear), 0, now);
  return true;
}

// --- What the board says -------------------------------------------------------------------------

void BoardLink::on_bytes(ByteView bytes, TimePoint now) {
  if (stage_ == Stage::closed) return;
  if (stage_ == Stage::resyncing) {
    bytes = resync_.on_bytes(bytes, now);
    if (resync_.state() != Resync::State::in_step) return;
    begin_start_up(now);
  }
  for (const Bytes& frame : decoder_.on_bytes(bytes, now)) {
    if (stage_ == Stage::resyncing || stage_ == Stage::closed) return;
    on_frame(frame, now);
  }
  if (decoder_.has_lost_step()) begin_resync(now);
}

void BoardLink::on_frame(const Bytes& frame, TimePoint now) {
  Result<Event, DecodeError> event = decode_event(frame);
  if (!event.has_value()) {
    ++counters_.malformed_events;
    if (const auto count = malformed_burst_.on_event(now))
      actions_.push(Notice{Severity::warning,
                           fmt::format("the serial board sent {} malformed event(s)", *count),
                           {}});
    return;
  }
  std::visit(overloaded{
                 [&](DeviceStarted& started) { on_event(started, now); },
                 [&](CommandResponse& response) { on_event(response, now); },
                 [](EchoResponse&) {},  // a late one, of an earlier attempt to get in step
                 [&](MessageReceived& message) {
                   if (is_up_) actions_.push(std::move(message));
                 },
                 [&](TxComplete&) { ++counters_.tx_complete; },
                 [&](IvUpdate& update) { actions_.push(update); },
                 [&](Heartbeat& heartbeat) {
                   if (is_up_) actions_.push(heartbeat);
                 },
                 [&](ProvisioningEvent& provisioning) {
                   if (is_up_) actions_.push(provisioning);
                 },
                 [&](OtherEvent&) { ++counters_.other_events; },
             },
             *event);
}

void BoardLink::on_event(DeviceStarted& event, TimePoint now) {
  // Everything the board held in RAM is void, and its answer to what was in flight with it.
  ++counters_.restarts;
  if (is_up_)
    go_down(event.hardware_error == 0 ? "the serial board restarted"
                                      : "the serial board restarted after its processor locked up");
  dropped_events_ = 0;
  begin_start_up(now);
}

void BoardLink::on_event(CommandResponse& response, TimePoint now) {
  if (response.opcode == 0 && response.status == Status::invalid_length)
    return begin_resync(now);  // the board lost step in what we wrote
  if (!in_flight_ || response.opcode != in_flight_->opcode) {
    ++counters_.other_events;
    return;
  }
  const InFlight command = *std::exchange(in_flight_, std::nullopt);
  if (stage_ == Stage::starting) {
    start_up_->on_response(response);
    continue_start_up(now);
  } else {
    consecutive_timeouts_ = 0;
    on_response(response, command, now);
    send_next(now);
  }
}

void BoardLink::on_response(const CommandResponse& response, const InFlight& command,
                            TimePoint now) {
  if (command.is_command) {
    on_command_ended(response);
  } else if (is_opcode(command.opcode, CommandOpcode::state_clear)) {
    on_board_cleared(response.status, now);
  } else if (is_opcode(command.opcode, CommandOpcode::packet_send)) {
    on_sent(response, command.destination);
  } else if (is_opcode(command.opcode, CommandOpcode::publication_add)) {
    on_publication_added(response, command.destination, now);
  } else if (is_opcode(command.opcode, CommandOpcode::housekeeping_get)) {
    ByteReader data(response.data);
    const std::uint32_t total = data.read_u32_le();
    if (response.status == Status::success && data.ok()) on_drop_counter(total, now);
  }
}

void BoardLink::on_command_ended(const CommandResponse& response) {
  command_.reset();
  actions_.push(
      CommandEnded{response.opcode, response.status, response.data, is_command_repeated_});
}

void BoardLink::on_board_cleared(Status status, TimePoint now) {
  is_clear_wanted_ = false;
  actions_.push(BoardCleared{status});
  if (status != Status::success) return;
  go_down("the serial board was cleared");
  begin_start_up(now);
}

void BoardLink::on_publication_added(const CommandResponse& response, std::uint16_t address,
                                     TimePoint now) {
  ByteReader data(response.data);
  const std::uint16_t handle = data.read_u16_le();
  if (response.status == Status::success && data.ok()) {
    addresses_.add_publication({address, handle});
    return;
  }
  if (response.status == Status::rejected) {  // its table is fuller than we know
    if (const auto oldest = addresses_.take_least_recent())
      return issue(encode_command(CommandOpcode::publication_remove, oldest->handle), 0, now);
  }
  refuse_send(address, fmt::format("the board gives no handle for 0x{:04x} ({})", address,
                                   to_string(response.status)));
  std::erase_if(urgent_, [&](const Outgoing& message) { return message.destination == address; });
  std::erase_if(normal_, [&](const Outgoing& message) { return message.destination == address; });
}

void BoardLink::on_sent(const CommandResponse& response, std::uint16_t destination) {
  if (response.status == Status::success) {
    ++counters_.sent;
    return;
  }
  if (response.status == Status::rejected) addresses_.forget_publication(destination);
  const std::string why =
      response.status == Status::invalid_state
          ? "an earlier segmented message to this robot is still being sent"
          : fmt::format("the board refuses to send ({})", to_string(response.status));
  refuse_send(destination, why);
}

void BoardLink::refuse_send(std::uint16_t destination, std::string why) {
  ++counters_.send_refused;
  actions_.push(SendRefused{destination, std::move(why)});
}

void BoardLink::on_drop_counter(std::uint32_t total, TimePoint now) {
  const std::uint32_t before = std::exchange(dropped_events_, total).value_or(total);
  if (total <= before) return;  // the first reading, no change, or the board restarted unseen
  counters_.board_drops += total - before;
  if (drop_burst_.on_event(now))
    actions_.push(Notice{Severity::warning,
                         fmt::format("the serial board dropped {} event(s) since it was last "
                                     "asked: the serial line is too slow for this mesh",
                                     total - before),
                         {}});
}

// --- One command in flight -----------------------------------------------------------------------

void BoardLink::issue(Bytes command, std::uint16_t destination, TimePoint now) {
  in_flight_ = InFlight{command[1], now + command_time_limit, destination};
  actions_.push(WriteSerial{std::move(command)});
}

std::deque<Outgoing>& BoardLink::next_queue() { return urgent_.empty() ? normal_ : urgent_; }

void BoardLink::send_next(TimePoint now) {
  if (stage_ != Stage::running || in_flight_) return;
  if (now >= poll_at_) {
    poll_at_ = now + poll_interval;
    return issue(encode_command(CommandOpcode::housekeeping_get), 0, now);
  }
  if (issue_clear(now)) return;
  if (urgent_.empty() && command_) {
    issue(*command_, 0, now);
    in_flight_->is_command = true;
    return;
  }
  std::deque<Outgoing>& queue = next_queue();
  if (!queue.empty()) send_message(queue, now);
}

void BoardLink::send_message(std::deque<Outgoing>& queue, TimePoint now) {
  const std::uint16_t destination = queue.front().destination;
  const auto handle = addresses_.publication_handle(destination);
  if (!handle) {
    if (addresses_.is_full()) {
      if (const auto oldest = addresses_.take_least_recent())
        return issue(encode_command(CommandOpcode::publication_remove, oldest->handle), 0, now);
    }
    return issue(encode_command(CommandOpcode::publication_add, destination), destination, now);
  }
  const Outgoing message = std::move(queue.front());
  queue.pop_front();
  issue(encode_packet_send({.appkey_handle = message.appkey_handle.value_or(appkey_handle_),
                            .source = settings_.board.address,
                            .destination_handle = *handle,
                            .ttl = settings_.ttl,
                            .payload = message.payload},
                           version_),
        destination, now);
}

}  // namespace slamgw::ble

// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic_serial/board_link.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace slamgw::ble {
namespace {

constexpr bool is_opcode(std::uint8_t octet, CommandOpcode opcode) {
  return octet == static_cast<std::uint8_t>(opcode);
}

}  // namespace

BoardLink::BoardLink(LinkSettings settings, std::optional<MeshKeys> keys, std::uint64_t seed)
    : settings_(std::move(settings)), keys_(keys), resync_(seed) {}

void BoardLink::on_port_open(TimePoint now) { begin_resync(now); }

void BoardLink::on_port_closed(const std::string& why, TimePoint) {
  stage_ = Stage::closed;
  in_flight_.reset();
  go_down(why);
}

bool BoardLink::send(Outgoing message, TimePoint now) {
  if (message.is_urgent) withdraw(message.destination, message.payload);
  if (!is_up_ || urgent_.size() + normal_.size() >= max_queued) return false;
  (message.is_urgent ? urgent_ : normal_).push_back(std::move(message));
  send_next(now);
  return true;
}

void BoardLink::withdraw(std::uint16_t destination, const Bytes& payload) {
  std::erase_if(urgent_, [&](const Outgoing& message) {
    return message.destination == destination && message.payload == payload;
  });
}

// --- Getting in step -----------------------------------------------------------------------------

void BoardLink::begin_resync(TimePoint now) {
  stage_ = Stage::resyncing;
  in_flight_.reset();
  decoder_.reset();
  ++counters_.resyncs;
  actions_.push(WriteSerial{resync_.start(now)});
}

void BoardLink::begin_start_up(TimePoint now) {
  stage_ = Stage::starting;
  in_flight_.reset();
  start_up_.emplace(settings_.board, keys_);
  continue_start_up(now);
}

void BoardLink::continue_start_up(TimePoint now) {
  for (Notice& notice : start_up_->take_notices()) say_once(notice.severity, notice.text);
  switch (start_up_->state()) {
    case StartUp::State::commanding: issue(start_up_->command(), 0, now); break;
    case StartUp::State::needs_keys:
      stage_ = Stage::awaiting_keys;
      actions_.push(GenerateKeys{});
      break;
    case StartUp::State::refused:
      stage_ = Stage::refused;
      retry_at_ = now + refusal_interval;
      go_down(start_up_->refusal());
      say_once(Severity::error, start_up_->refusal());
      break;
    case StartUp::State::done: on_started(now); break;
  }
}

void BoardLink::on_started(TimePoint now) {
  stage_ = Stage::running;
  addresses_ = start_up_->take_addresses();
  appkey_handle_ = start_up_->appkey_handle();
  if (start_up_->dropped_events()) on_drop_counter(*start_up_->dropped_events(), now);
  poll_at_ = now + poll_interval;
  reopen_delay_ = first_reopen_delay;
  if (!std::exchange(is_up_, true)) {
    down_reason_.clear();
    actions_.push(LinkIsUp{start_up_->description()});
  }
  send_next(now);
}

void BoardLink::on_keys(const MeshKeys& keys, TimePoint now) {
  keys_ = keys;
  if (stage_ != Stage::awaiting_keys) return;  // the port went meanwhile; used at the next start
  stage_ = Stage::starting;
  start_up_->on_keys(keys);
  continue_start_up(now);
}

void BoardLink::on_keys_failed(const std::string& why, TimePoint now) {
  if (stage_ != Stage::awaiting_keys) return;
  stage_ = Stage::refused;
  retry_at_ = now + refusal_interval;
  go_down(why);
  say_once(Severity::error, why);
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
  std::visit(
      overloaded{
          [&](DeviceStarted& started) { on_event(started, now); },
          [&](CommandResponse& response) { on_event(response, now); },
          [](EchoResponse&) {},  // a late one, of an earlier attempt to get in step
          [&](MessageReceived& message) {
            if (is_up_) actions_.push(std::move(message));
          },
          [&](TxComplete&) { ++counters_.tx_complete; },
          [&](IvUpdate& update) {
            actions_.push(Notice{
                Severity::info, fmt::format("the mesh's IV index is {}", update.iv_index), {}});
          },
          [&](Heartbeat& heartbeat) {
            if (is_up_) actions_.push(heartbeat);
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
  if (is_opcode(command.opcode, CommandOpcode::packet_send)) {
    on_sent(response, command.destination);
  } else if (is_opcode(command.opcode, CommandOpcode::publication_add)) {
    on_publication_added(response, command.destination, now);
  } else if (is_opcode(command.opcode, CommandOpcode::housekeeping_get)) {
    ByteReader data(response.data);
    const std::uint32_t total = data.read_u32_le();
    if (response.status == Status::success && data.ok()) on_drop_counter(total, now);
  }
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
  ++counters_.send_refused;
  actions_.push(SendRefused{address, fmt::format("the board gives no handle for 0x{:04x} ({})",
                                                 address, to_string(response.status))});
  std::erase_if(urgent_, [&](const Outgoing& message) { return message.destination == address; });
  std::erase_if(normal_, [&](const Outgoing& message) { return message.destination == address; });
}

void BoardLink::on_sent(const CommandResponse& response, std::uint16_t destination) {
  if (response.status == Status::success) {
    ++counters_.sent;
    return;
  }
  ++counters_.send_refused;
  if (response.status == Status::rejected) addresses_.forget_publication(destination);
  const std::string why =
      response.status == Status::invalid_state
          ? "an earlier segmented message to this robot is still being sent"
          : fmt::format("the board refuses to send ({})", to_string(response.status));
  actions_.push(SendRefused{destination, why});
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
  std::deque<Outgoing>& queue = next_queue();
  if (queue.empty()) return;
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
                            .payload = message.payload}),
        destination, now);
}

// --- Time ----------------------------------------------------------------------------------------

std::optional<TimePoint> BoardLink::deadline() const {
  switch (stage_) {
    case Stage::closed: return std::nullopt;
    case Stage::resyncing: return resync_.deadline();
    case Stage::refused: return earlier(retry_at_, decoder_.deadline());
    case Stage::awaiting_keys: return decoder_.deadline();
    case Stage::starting:
    case Stage::running: break;
  }
  std::optional<TimePoint> next = decoder_.deadline();
  if (in_flight_) next = earlier(next, in_flight_->deadline);
  if (stage_ == Stage::running && !in_flight_) next = earlier(next, poll_at_);
  return next;
}

void BoardLink::on_deadline(TimePoint now) {
  if (stage_ == Stage::closed) return;
  if (stage_ == Stage::resyncing) {
    if (auto bytes = resync_.on_deadline(now)) actions_.push(WriteSerial{std::move(*bytes)});
    if (resync_.state() == Resync::State::failed) on_silence();
    return;
  }
  decoder_.on_deadline(now);
  if (decoder_.has_lost_step()) return begin_resync(now);
  if (in_flight_ && now >= in_flight_->deadline) return on_command_timeout(now);
  if (stage_ == Stage::refused && now >= retry_at_) return begin_resync(now);
  send_next(now);
}

void BoardLink::on_command_timeout(TimePoint now) {
  ++counters_.command_timeouts;
  if (++consecutive_timeouts_ < max_consecutive_timeouts) return begin_resync(now);
  consecutive_timeouts_ = 0;
  give_up(fmt::format("the serial board answers Echo but not command 0x{:02x}", in_flight_->opcode),
          "does its firmware have Nordic's mesh commands?");
}

void BoardLink::give_up(const std::string& why, const std::string& what_to_check) {
  stage_ = Stage::closed;
  in_flight_.reset();
  go_down(why);
  say_once(Severity::warning, why + ": " + what_to_check);
  actions_.push(ReopenPort{reopen_delay_});
  reopen_delay_ = std::min(reopen_delay_ * 2, max_reopen_delay);
}

void BoardLink::on_silence() {
  if (resync_.octets_seen() == 0)
    return give_up("the serial board answers nothing",
                   "is it Nordic's serial board and powered? Check the cable, ble_mesh.device, "
                   "ble_mesh.flow_control, and that no other program (ModemManager) uses it");
  give_up("the device sends something, but not Nordic's serial protocol",
          "is it the right device? Check ble_mesh.device, ble_mesh.baud_rate, and "
          "ble_mesh.protocol (firmware that only streams positions needs \"cobs\")");
}

void BoardLink::go_down(const std::string& why) {
  urgent_.clear();
  normal_.clear();
  const bool was_up = std::exchange(is_up_, false);
  if (was_up) said_.clear();
  if (std::exchange(down_reason_, why) == why && !was_up) return;
  actions_.push(LinkIsDown{why});
}

void BoardLink::say_once(Severity severity, const std::string& text) {
  if (said_.size() >= max_said || !said_.insert(text).second) return;
  actions_.push(Notice{severity, text, {}});
}

}  // namespace slamgw::ble

// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/board_link.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/nordic/serial_protocol.hpp"

namespace slamgw::ble {

void LineHealth::on_lost_step(TimePoint now) {
  has_lost_step_ = true;
  count(now);
}

void LineHealth::on_timeout(std::uint8_t opcode, TimePoint now) {
  timeouts_ = opcode == silent_opcode_ ? timeouts_ + 1 : 1;
  silent_opcode_ = opcode;
  count(now);
}

void LineHealth::on_answer(std::uint8_t opcode) {
  if (opcode == silent_opcode_) timeouts_ = 0;
}

void LineHealth::count(TimePoint now) {
  if (now >= stable_at()) losses_ = 0;
  ++losses_;
  last_loss_ = now;
}

std::optional<std::string> LineHealth::verdict() const {
  if (timeouts_ >= max_timeouts && !has_lost_step_)
    return fmt::format(
        "the serial board answers Echo but not command 0x{:02x}: either the serial line loses "
        "octets (check the cable, the USB hub and ble_mesh.flow_control), or the firmware is not "
        "Nordic's serial example",
        silent_opcode_);
  if (timeouts_ >= max_timeouts || losses_ >= max_losses)
    return "octets are lost or added on the serial line to the board: check the cable, the USB hub "
           "and its power supply, ble_mesh.flow_control, and that no other program uses the port";
  return std::nullopt;
}

namespace {

constexpr std::size_t longest_frame_body = 255;
constexpr std::uint8_t echo_response = 0x82;
constexpr std::uint32_t refusal_of_zero = 0x03840084;  // as it comes over the wire

}  // namespace

Bytes Resync::start(TimePoint now) {
  attempts_ = 0;
  octets_seen_ = 0;
  last_octets_ = 0;
  has_seen_refusal_ = false;
  return flush(now);
}

Bytes Resync::flush(TimePoint now) {
  ++attempts_;
  state_ = State::awaiting_quiet;
  due_ = now + quiet_time;
  quiet_limit_ = now + max_wait_for_quiet;
  return Bytes(longest_frame_body, 0);
}

ByteView Resync::on_bytes(ByteView bytes, TimePoint now) {
  octets_seen_ += bytes.size();
  if (!is_waiting()) return {};
  for (const std::uint8_t octet : bytes) {
    last_octets_ = last_octets_ << 8 | octet;
    if (last_octets_ == refusal_of_zero) has_seen_refusal_ = true;
  }
  if (state_ == State::awaiting_quiet) {
    due_ = std::min(now + quiet_time, quiet_limit_);
    return {};
  }
  const std::size_t known = tail_.size();
  tail_.insert(tail_.end(), bytes.begin(), bytes.end());
  const auto found = std::search(tail_.begin(), tail_.end(), awaited_.begin(), awaited_.end());
  if (found != tail_.end()) {
    state_ = State::in_step;
    const auto border = static_cast<std::size_t>(found - tail_.begin()) + awaited_.size();
    return bytes.subspan(border - known);
  }
  if (tail_.size() >= awaited_.size())
    tail_.erase(tail_.begin(), tail_.end() - static_cast<std::ptrdiff_t>(awaited_.size() - 1));
  return {};
}

std::optional<TimePoint> Resync::deadline() const {
  return is_waiting() ? std::optional(due_) : std::nullopt;
}

std::optional<Bytes> Resync::on_deadline(TimePoint now) {
  if (!is_waiting() || now < due_) return std::nullopt;
  if (state_ == State::awaiting_quiet) {
    state_ = State::awaiting_echo;
    due_ = now + echo_time_limits.at(attempts_ - 1);
    tail_.clear();
    const Bytes nonce = ByteWriter{}
                            .write_u32_le(static_cast<std::uint32_t>(random_()))
                            .write_u32_le(static_cast<std::uint32_t>(random_()))
                            .take();
    awaited_ = encode_frame(echo_response, nonce);
    return encode_command(CommandOpcode::echo, nonce);
  }
  if (attempts_ < echo_time_limits.size()) return flush(now);
  state_ = State::failed;
  return std::nullopt;
}

BoardLink::BoardLink(Settings settings, std::optional<RadioKeys> keys, std::uint64_t seed)
    : settings_(std::move(settings)), keys_(keys), resync_(seed) {}

void BoardLink::on_port_open(TimePoint now) {
  health_ = {};
  begin_resync(now);
}

void BoardLink::on_port_closed(const std::string& why, TimePoint) {
  stage_ = Stage::closed;
  go_down(why);
}

void BoardLink::change_keys(const RadioKeys& keys, TimePoint now) {
  const bool goes_down = keys_ ? keys_->keys != keys.keys : is_up();
  keys_ = keys;
  if (awaits(StartUp::State::needs_keys)) return on_keys_needed(now);
  if (stage_ == Stage::closed) return;
  if (goes_down) go_down("the mesh has new keys");
  begin_resync(now);
}

// --- Getting in step -----------------------------------------------------------------------------

void BoardLink::begin_resync(TimePoint now) {
  stage_ = Stage::resyncing;
  if (in_flight_ && in_flight_->issuer == Issuer::radio) actions_.push(AnswerLost{});
  in_flight_.reset();
  busy_until_.reset();
  dropped_events_.reset();  // the board drops answers to the zeros, too
  decoder_.reset();
  ++counters_.resyncs;
  actions_.push(WriteSerial{resync_.start(now)});
}

void BoardLink::on_lost_step(TimePoint now) {
  health_.on_lost_step(now);
  get_in_step_again(now);
}

void BoardLink::get_in_step_again(TimePoint now) {
  if (const auto why = health_.verdict()) return give_up(*why, max_unusable_delay);
  if (health_.losses() >= LineHealth::noticeable_losses && loss_throttle_.on_event(now))
    warn(
        fmt::format("octets are lost or added on the serial line to the board, {} times in a row "
                    "so far: messages get lost",
                    health_.losses()));
  begin_resync(now);
}

void BoardLink::begin_start_up(TimePoint now) {
  stage_ = Stage::starting;
  in_flight_.reset();
  busy_until_.reset();
  busy_answers_ = 0;
  start_up_.emplace(settings_, keys_);
  continue_start_up(now);
}

void BoardLink::continue_start_up(TimePoint now) {
  for (Notice& notice : start_up_->take_notices()) notify_once(notice.severity, notice.text);
  switch (start_up_->state()) {
    case StartUp::State::commanding: issue(start_up_->command(), Issuer::start_up, now); break;
    case StartUp::State::needs_keys: on_keys_needed(now); break;
    case StartUp::State::needs_source: on_source_needed(now); break;
    case StartUp::State::needs_clear:
      issue(encode_command(CommandOpcode::state_clear), Issuer::clear, now);
      break;
    case StartUp::State::refused: on_refused(now); break;
    case StartUp::State::done: on_started(now); break;
  }
}

/// A lost octet in an answer can make a good board look unusable: the same refusal must come twice.
void BoardLink::on_refused(TimePoint now) {
  if (unconfirmed_refusal_ != start_up_->refusal()) {
    unconfirmed_refusal_ = start_up_->refusal();
    return begin_resync(now);
  }
  refuse(start_up_->refusal(), now);
  issue_clear(now);
}

void BoardLink::refuse(const std::string& why, TimePoint now) {
  stage_ = Stage::refused;
  retry_at_ = now + refusal_interval;
  go_down(why);
  notify_once(Severity::error, why);
}

void BoardLink::on_started(TimePoint now) {
  stage_ = Stage::running;
  unconfirmed_refusal_.clear();
  const StartedBoard& board = start_up_->board();
  actions_.push(board);
  if (board.dropped_events) on_drop_counter(*board.dropped_events, now);
  poll_at_ = now + poll_interval;
  was_cleared_ = false;
  const bool has_kept_address =
      std::exchange(has_restarted_, false) && start_up_->had_addresses() > 0;
  if (!std::exchange(is_up_, true)) {
    down_reason_.clear();
    actions_.push(LinkIsUp{start_up_->description(), board.uuid, board.source, has_kept_address});
  }
  send_next(now);
}

void BoardLink::on_keys_needed(TimePoint now) {
  if (!keys_) return actions_.push(KeysWanted{});
  start_up_->on_keys(*keys_);
  continue_start_up(now);
}

/// A board that was up until now and has no address has restarted without saying so.
void BoardLink::on_source_needed(TimePoint now) {
  const std::uint16_t addresses = start_up_->had_addresses();
  if (addresses == 0 && is_up_) {
    ++counters_.restarts;
    not_suspected_until_ = now + confirmed_interval;
    go_down("the serial board restarted without a start event");
  }
  actions_.push(SourceWanted{start_up_->board().uuid, addresses, was_cleared_});
}

void BoardLink::on_source(std::uint16_t source, std::uint16_t count, TimePoint now) {
  if (!awaits(StartUp::State::needs_source)) return;
  start_up_->on_source(source, count);
  continue_start_up(now);
}

void BoardLink::on_source_delayed(const std::string& why) {
  if (awaits(StartUp::State::needs_source))
    go_down("the board waits for its next address until that is on disk: " + why);
}

void BoardLink::on_keys_failed(const std::string& why, TimePoint now) {
  if (awaits(StartUp::State::needs_keys)) refuse(why, now);
}

// --- Events of the board -------------------------------------------------------------------------

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
  if (decoder_.has_lost_step()) on_lost_step(now);
}

void BoardLink::on_frame(const Bytes& frame, TimePoint now) {
  Result<Event, DecodeError> event = decode_event(frame);
  if (!event.has_value()) {
    ++counters_.malformed_events;
    if (const auto count = malformed_throttle_.on_event(now))
      warn(fmt::format("the serial board sent {} malformed event(s)", *count));
    return;
  }
  std::visit(overloaded{
                 [&](DeviceStarted& started) { on_event(started, now); },
                 [&](CommandResponse& response) { on_event(response, now); },
                 [](EchoResponse&) {},  // late, of an earlier attempt to get in step
                 [&](MessageReceived& message) {
                   if (is_up_) actions_.push(std::move(message));
                 },
                 [&](TxComplete&) { ++counters_.tx_complete; },
                 [&](IvUpdate& update) { actions_.push(update); },
                 [&](Heartbeat& heartbeat) {
                   if (is_up_) actions_.push(heartbeat);
                 },
                 [&](ProvisioningEvent& provisioning) {  // a device key comes only once
                   if (is_up_ || std::holds_alternative<ProvisioningComplete>(provisioning))
                     actions_.push(provisioning);
                 },
                 [&](OtherEvent&) { ++counters_.other_events; },
             },
             *event);
}

void BoardLink::on_event(DeviceStarted& event, TimePoint now) {
  // The board has lost everything in RAM, and with it the answer to the command in flight.
  ++counters_.restarts;
  has_restarted_ = has_restarted_ || is_up_;
  if (is_up_)
    go_down(event.hardware_error == 0 ? "the serial board restarted"
                                      : "the serial board restarted after its processor locked up");
  dropped_events_ = 0;
  begin_start_up(now);
}

void BoardLink::on_event(CommandResponse& response, TimePoint now) {
  if (response.opcode == 0 && response.status == Status::invalid_length)
    return on_lost_step(now);  // the board lost step in the octets sent to it
  if (!in_flight_ || response.opcode != in_flight_->opcode) {
    ++counters_.other_events;
    return;
  }
  const Issuer issuer = std::exchange(in_flight_, std::nullopt)->issuer;
  health_.on_answer(response.opcode);
  if (stage_ == Stage::starting && issuer == Issuer::start_up) {
    if (response.status == Status::busy && ++busy_answers_ <= max_busy_answers) {
      busy_until_ = now + busy_pause;
      return;
    }
    start_up_->on_response(response);
    continue_start_up(now);
  } else {
    on_response(response, issuer, now);
    send_next(now);
  }
}

void BoardLink::on_response(CommandResponse& response, Issuer issuer, TimePoint now) {
  switch (issuer) {
    case Issuer::start_up: return;  // handled while starting
    case Issuer::poll: return on_polled(response, now);
    case Issuer::clear: return on_board_cleared(response.status, now);
    case Issuer::radio: break;
  }
  // "Invalid data": the board has lost the source address that it got at start-up.
  const bool is_address_lost =
      response.opcode == static_cast<std::uint8_t>(CommandOpcode::packet_send) &&
      response.status == Status::invalid_data;
  actions_.push(std::move(response));
  if (is_address_lost) on_address_lost(now);
}

void BoardLink::on_board_cleared(Status status, TimePoint now) {
  if (std::exchange(is_clear_wanted_, false))
    actions_.push(
        RadioCleared{status == Status::success ? std::string() : std::string(to_string(status))});
  if (status != Status::success && stage_ == Stage::starting)
    refuse(fmt::format("the serial board can't be used: it keeps the mesh's former keys ({})",
                       to_string(status)),
           now);
  if (status != Status::success) return;
  was_cleared_ = true;
  go_down("the serial board was cleared");
  begin_start_up(now);
}

void BoardLink::on_polled(const CommandResponse& response, TimePoint now) {
  if (now >= health_.stable_at()) reopen_delay_ = first_reopen_delay;
  ByteReader data(response.data);
  const bool is_good = response.status == Status::success;
  if (response.opcode == static_cast<std::uint8_t>(CommandOpcode::local_unicast_get)) {
    data.read_u16_le();
    if (data.read_u16_le() == 0 && is_good && data.ok()) on_address_lost(now);
    return;
  }
  const std::uint32_t total = data.read_u32_le();
  if (is_good && data.ok()) on_drop_counter(total, now);
}

/// The board may have restarted without its event 0x81, such as by its reset button. The start-up
/// finds out, and takes the link down only in that case.
void BoardLink::on_address_lost(TimePoint now) {
  if (now < not_suspected_until_) return;
  not_suspected_until_ = now + refusal_interval;
  begin_start_up(now);
}

void BoardLink::on_drop_counter(std::uint32_t total, TimePoint now) {
  const std::uint32_t before = std::exchange(dropped_events_, total).value_or(total);
  if (total <= before) return;  // the first since a resync, no change, or an unseen restart
  counters_.board_drops += total - before;
  if (drop_throttle_.on_event(now))
    warn(
        fmt::format("the serial board dropped {} event(s) since it was last asked: the serial line "
                    "is too slow for this mesh",
                    total - before));
}

// --- Sending -------------------------------------------------------------------------------------

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

void BoardLink::issue_clear(TimePoint now) {
  if (is_clear_wanted_ && !in_flight_)
    issue(encode_command(CommandOpcode::state_clear), Issuer::clear, now);
}

/// Issues the link's own next command if it is due and none is in flight.
void BoardLink::send_next(TimePoint now) {
  if (stage_ != Stage::running || in_flight_) return;
  if (now >= poll_at_) {
    poll_at_ = now + poll_interval;
    is_address_polled_next_ = !is_address_polled_next_;
    return issue(encode_command(is_address_polled_next_ ? CommandOpcode::housekeeping_get
                                                        : CommandOpcode::local_unicast_get),
                 Issuer::poll, now);
  }
  issue_clear(now);
}

void BoardLink::issue(Bytes command, Issuer issuer, TimePoint now) {
  in_flight_ = InFlight{command[1], now + command_time_limit, issuer};
  actions_.push(WriteSerial{std::move(command)});
}

// --- Time ----------------------------------------------------------------------------------------

std::optional<TimePoint> BoardLink::deadline() const {
  if (stage_ == Stage::closed) return std::nullopt;
  if (stage_ == Stage::resyncing) return resync_.deadline();
  std::optional<TimePoint> next = decoder_.deadline();
  if (in_flight_) next = earlier(next, in_flight_->deadline);
  if (stage_ == Stage::starting) next = earlier(next, busy_until_);
  if (stage_ == Stage::running && !in_flight_) next = earlier(next, poll_at_);
  if (stage_ == Stage::refused && !in_flight_) next = earlier(next, retry_at_);
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
  if (decoder_.has_lost_step()) return on_lost_step(now);
  if (busy_until_ && now >= *busy_until_) {
    busy_until_.reset();
    return continue_start_up(now);
  }
  if (in_flight_ && now >= in_flight_->deadline) return on_command_timeout(now);
  if (stage_ == Stage::refused && !in_flight_ && now >= retry_at_) return begin_resync(now);
  send_next(now);
}

void BoardLink::on_command_timeout(TimePoint now) {
  ++counters_.command_timeouts;
  health_.on_timeout(in_flight_->opcode, now);
  get_in_step_again(now);
}

void BoardLink::give_up(const std::string& why, Duration max_delay) {
  stage_ = Stage::closed;
  go_down(why);
  reopen_delay_ = std::min(reopen_delay_, max_delay);
  actions_.push(ReopenPort{reopen_delay_});
  reopen_delay_ *= 2;
}

void BoardLink::on_silence() {
  if (resync_.octets_seen() == 0)
    return give_up(
        "the serial board does not answer: is it Nordic's serial board and powered? Check the "
        "cable, ble_mesh.device, ble_mesh.flow_control, and that no other program (ModemManager) "
        "uses it",
        max_reopen_delay);
  if (resync_.has_seen_refusal())
    return give_up(
        "the serial board speaks Nordic's serial protocol, but its echo is damaged: "
        "octets are lost or added on the serial line; check the cable, the USB hub and "
        "ble_mesh.flow_control",
        max_reopen_delay);
  give_up(
      "the device sends something, but not Nordic's serial protocol: is it the right device? Check "
      "ble_mesh.device, ble_mesh.baud_rate, and ble_mesh.protocol (firmware that only streams "
      "positions needs \"cobs\")",
      max_reopen_delay);
}

void BoardLink::go_down(const std::string& why) {
  in_flight_.reset();
  if (stage_ == Stage::closed) {
    has_restarted_ = false;
    if (std::exchange(is_clear_wanted_, false)) actions_.push(RadioCleared{why});
  }
  const bool was_up = std::exchange(is_up_, false);
  if (was_up) notified_.clear();
  if (std::exchange(down_reason_, why) == why && !was_up) return;
  actions_.push(LinkIsDown{why});
}

void BoardLink::notify_once(Severity severity, const std::string& text) {
  if (notified_.size() >= max_notified || !notified_.insert(text).second) return;
  actions_.push(Notice{severity, text, {}});
}

}  // namespace slamgw::ble

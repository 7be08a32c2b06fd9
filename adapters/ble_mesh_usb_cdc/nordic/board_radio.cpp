// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/board_radio.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace slamgw::ble {
namespace {

constexpr std::chrono::seconds scan_retry_pause{30};

}  // namespace

// --- Requests of the mesh ------------------------------------------------------------------------

void BoardRadio::send(Outgoing message, TimePoint) {
  if (message.is_under_device_key) {
    const auto key = device_keys_.find(message.destination);
    if (key == device_keys_.end() || !key->second.handle) return;
    message.key = key->second.handle;
  }
  if (!link_.is_up() || !traffic_.send(std::move(message))) ++sends_dropped_;
}

void BoardRadio::provision(const ProvisionDevice& device) {
  device_ = device;
  is_last_context_ = false;
}

void BoardRadio::answer_device(const std::string& refusal, TimePoint now) {
  if (!session_) return;
  if (refusal.empty()) return session_->on_addresses(now);
  session_->fail(refusal);
  end_session();
}

/// The board drops the link after a while, and the device can join again.
void BoardRadio::break_off_join(const std::string& why) {
  if (session_ && session_->may_have_joined()) return;
  session_.reset();
  if (std::exchange(device_, std::nullopt)) actions_.push(JoinEnded{.failure = why});
}

void BoardRadio::use_device_key(std::uint16_t address, const std::optional<Key>& key) {
  if (!key) {
    actions_.push(DeviceKeyUsed{address, "this gateway does not have its device key"});
    return;
  }
  DeviceKey& known = device_keys_[address];
  known.wanted = key;
  if (known.is_there() && !is_commanded(address)) actions_.push(DeviceKeyUsed{address, {}});
}

void BoardRadio::forget_device_key(std::uint16_t address) {
  const auto known = device_keys_.find(address);
  if (known == device_keys_.end()) return;
  known->second.wanted.reset();
  if (known->second.handle || is_commanded(address)) return;
  device_keys_.erase(known);
  actions_.push(DeviceKeyUsed{address, {}});
}

void BoardRadio::clear(TimePoint now) {
  if (!link_.clear_board(now)) actions_.push(RadioCleared{"the BLE link is down"});
}

bool BoardRadio::restart(TimePoint) {
  is_restart_wanted_ = link_.is_up();
  return is_restart_wanted_;
}

/// The board gets its next command only when the mesh has handled all earlier events.
std::optional<RadioAction> BoardRadio::next_action(TimePoint now) {
  do {
    if (auto action = actions_.pop()) return action;
    while (auto from_link = link_.next_action()) {
      std::visit(overloaded{
                     [&](StartedBoard& board) { on_started(board); },
                     [&](CommandResponse& response) { on_response(response, now); },
                     [&](AnswerLost&) { on_answer_lost(); },
                     [&](ProvisioningEvent& event) { on_event(event, now); },
                     [&](MessageReceived& message) { on_message(message); },
                     [&](LinkIsDown& down) { on_link_down(down); },
                     [&](auto& as_it_is) { actions_.push(std::move(as_it_is)); },
                 },
                 *from_link);
      if (auto action = actions_.pop()) return action;
    }
  } while (begin_next(now));
  return std::nullopt;
}

void BoardRadio::on_deadline(TimePoint now) {
  link_.on_deadline(now);
  if (scan_retry_at_ && *scan_retry_at_ <= now) scan_retry_at_.reset();
  if (hold_until_ && *hold_until_ <= now) hold_until_.reset();
  if (session_) session_->on_deadline(now);
  end_session();
}

// --- Events of the board -------------------------------------------------------------------------

/// A board that was up may have restarted unnoticed, and does not scan then.
void BoardRadio::on_started(const StartedBoard& board) {
  traffic_.on_started(board);
  if (is_scan_wanted_) is_scanning_ = false;
}

void BoardRadio::on_answer_lost() {
  if (traffic_.awaits_response()) return traffic_.on_answer_lost();
  if (!command_) return;
  // A board that keeps its address may have restarted without a word.
  const bool is_done = command_->purpose == Command::Purpose::restart && command_->is_repeat;
  command_->is_repeat = true;
  if (is_done) command_.reset();
}

void BoardRadio::on_response(const CommandResponse& response, TimePoint now) {
  if (traffic_.awaits_response()) return traffic_.on_response(response);
  if (!command_) return;
  const Command ended = std::move(*command_);
  command_.reset();
  switch (ended.purpose) {
    case Command::Purpose::restart: return;  // the board can't restart
    case Command::Purpose::scan_control: return on_scan_changed(response, now);
    case Command::Purpose::session:
      if (session_) session_->on_response(response, ended.is_repeat);
      return end_session();
    case Command::Purpose::sweep: return sweep_.on_response(response);
    case Command::Purpose::device_key: return on_device_key(ended, response);
  }
}

/// "Invalid state": the board scans already, or has stopped already.
void BoardRadio::on_scan_changed(const CommandResponse& response, TimePoint now) {
  const bool is_start = response.opcode == static_cast<std::uint8_t>(CommandOpcode::scan_start);
  if (response.status == Status::success || response.status == Status::invalid_state) {
    is_scanning_ = is_start;
    return;
  }
  scan_retry_at_ = now + scan_retry_pause;
  if (!scan_lines_.on_event(now)) return;
  actions_.push(Notice{Severity::warning,
                       fmt::format("the serial board does not {} scanning for new robots ({}); the "
                                   "gateway tries again every {} s",
                                   is_start ? "start" : "stop", to_string(response.status),
                                   scan_retry_pause.count()),
                       {}});
}

/// If the board refuses to add or delete a key, its table has unknown entries. The table is then
/// swept before the next key is added.
void BoardRadio::on_device_key(const Command& command, const CommandResponse& response) {
  DeviceKey& key = device_keys_.at(command.node);
  DeviceKeyUsed used{command.node, {}};
  const bool is_success = response.status == Status::success;
  if (key.handle) {  // the command was to delete it
    if (!is_success && !command.is_repeat) sweep_ = {};
    key = {.wanted = key.wanted};
    if (key.wanted) return;  // another key is to be added
  } else {
    ByteReader data(response.data);
    key.handle = data.read_u16_le();
    if (is_success && data.ok() && !key.is_there()) return;  // the key is not wanted any more
    if (!is_success || !data.ok()) {
      sweep_ = {};
      key.wanted.reset();
      used.problem = fmt::format("the serial board does not take its device key ({})",
                                 to_string(response.status));
    }
  }
  if (!key.wanted) device_keys_.erase(command.node);
  actions_.push(std::move(used));
}

void BoardRadio::on_event(const ProvisioningEvent& event, TimePoint now) {
  if (const auto* beacon = std::get_if<UnprovisionedBeacon>(&event)) return actions_.push(*beacon);
  if (std::holds_alternative<ProvisioningLinkOpened>(event)) hold_until_ = now + longest_hold;
  if (std::holds_alternative<ProvisioningComplete>(event) ||
      std::holds_alternative<ProvisioningLinkClosed>(event))
    hold_until_.reset();
  const auto* joined = std::get_if<ProvisioningComplete>(&event);
  if (joined && !(session_ && session_->awaits(*joined)))
    return actions_.push(DeviceHadJoined{joined->address, joined->net_key, joined->device_key});
  if (!session_) return;
  session_->on_event(event, now);
  end_session();
}

void BoardRadio::on_message(MessageReceived& message) {
  const auto key = device_keys_.find(message.source);
  message.is_under_device_key = key != device_keys_.end() && key->second.handle == message.key;
  actions_.push(std::move(message));
}

void BoardRadio::on_link_down(LinkIsDown& down) {
  down.is_restart = command_ && command_->purpose == Command::Purpose::restart;
  if (session_) {
    session_->on_link_lost("the BLE link went down: " + down.why);
    down.join = session_->end();
  }
  forget();
  actions_.push(std::move(down));
}

/// Forgets all requests: the board that comes up next does not know them.
void BoardRadio::forget() {
  traffic_.on_link_down();
  command_.reset();
  hold_until_.reset();
  is_restart_wanted_ = is_scan_wanted_ = is_scanning_ = false;
  scan_retry_at_.reset();
  device_.reset();
  session_.reset();
  sweep_ = {};
  device_keys_.clear();
}

// --- The next steps ------------------------------------------------------------------------------

/// Gives the board its next command: urgent messages overtake the commands, and those overtake the
/// other messages. Returns true if there may be new actions.
bool BoardRadio::begin_next(TimePoint now) {
  if (!link_.is_ready()) return false;
  // A session begins only after the last answer for an earlier one: it could take that for its own.
  if (device_ && !session_ && !command_ && !begin_session(now)) return true;
  if (!command_) command_ = choose();
  auto frame = traffic_.next(/*is_holding=*/command_ || hold_until_);
  if (!frame && command_) frame = command_->frame;
  if (frame) link_.send(std::move(*frame), now);
  return frame.has_value();
}

/// Returns the next command for an idle board.
std::optional<BoardRadio::Command> BoardRadio::choose() {
  using Purpose = Command::Purpose;
  if (!hold_until_ && std::exchange(is_restart_wanted_, false))
    return Command{Purpose::restart, encode_command(CommandOpcode::radio_reset)};
  if (is_scan_wanted_ != is_scanning_ && !scan_retry_at_)
    return Command{
        Purpose::scan_control,
        encode_command(is_scan_wanted_ ? CommandOpcode::scan_start : CommandOpcode::scan_stop)};
  if (auto frame = session_ ? session_->command() : std::nullopt)
    return Command{Purpose::session, std::move(*frame)};
  return key_command();
}

/// Returns the next command about device keys. A key is added when the table has no unknown keys.
std::optional<BoardRadio::Command> BoardRadio::key_command() {
  using Purpose = Command::Purpose;
  const auto due = std::ranges::find_if(device_keys_,
                                        [](const auto& entry) { return !entry.second.is_there(); });
  if (due == device_keys_.end()) return std::nullopt;
  auto& [address, key] = *due;
  if (key.handle)
    return Command{Purpose::device_key, encode_command(CommandOpcode::devkey_delete, *key.handle),
                   address};
  const auto is_own = [&](std::uint16_t handle) {
    return std::ranges::any_of(device_keys_,
                               [&](const auto& own) { return own.second.handle == handle; });
  };
  if (auto sweep = sweep_.command(is_own)) return Command{Purpose::sweep, std::move(*sweep)};
  key.on_board = key.wanted;
  return Command{Purpose::device_key,
                 encode_command(CommandOpcode::devkey_add, address, traffic_.board().subnet_handle,
                                *key.wanted),
                 address};
}

bool BoardRadio::begin_session(TimePoint now) {
  const auto pair = make_key_pair(random_);
  if (!pair) {
    device_.reset();
    actions_.push(JoinEnded{.failure = "no randomness for the keys of a new robot"});
    return false;
  }
  context_ = context_ == 0 ? 1 : 0;
  session_.emplace(*device_, *pair, context_, traffic_.board(), actions_, now);
  return true;
}

void BoardRadio::end_session() {
  if (!session_ || session_->state() == ProvisioningSession::State::running) return;
  JoinEnded end = session_->end();
  const bool is_tried_again =
      !end.failure.empty() && session_->is_context_busy() && !std::exchange(is_last_context_, true);
  session_.reset();
  if (is_tried_again) return;  // in the board's other context
  device_.reset();
  actions_.push(std::move(end));
}

Counters BoardRadio::counters() const {
  const LinkCounters& link = link_.counters();
  return {{"sends_dropped", sends_dropped_},
          {"sent", traffic_.sent()},
          {"send_refused", traffic_.refused()},
          {"tx_complete", link.tx_complete},
          {"board_drops", link.board_drops},
          {"board_restarts", link.restarts},
          {"resyncs", link.resyncs},
          {"command_timeouts", link.command_timeouts},
          {"malformed_events", link.malformed_events},
          {"other_events", link.other_events}};
}

}  // namespace slamgw::ble

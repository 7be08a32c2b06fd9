// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/board_radio.hpp"

#include <fmt/format.h>

#include <utility>

namespace slamgw::ble {
namespace {

constexpr std::chrono::seconds scan_retry_pause{30};

}  // namespace

// --- Requests of the mesh ------------------------------------------------------------------------

void BoardRadio::send(Outgoing message, TimePoint now) {
  if (message.is_under_device_key) {
    const auto key = device_keys_.find(message.destination);
    if (key == device_keys_.end() || !key->second.handle) return;
    message.key = key->second.handle;
  }
  link_.send(std::move(message), now);
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

void BoardRadio::use_device_key(std::uint16_t address, const std::optional<Key>& key) {
  if (!key) {
    actions_.push(DeviceKeyUsed{address, "this gateway does not have its device key"});
    return;
  }
  const auto [entry, is_new] = device_keys_.try_emplace(address);
  DeviceKey& known = entry->second;
  known.wanted = key;
  if (is_new) known.is_waiting = !sweep_.is_done();
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

/// The board gets its next command only when the mesh has handled all earlier events.
std::optional<RadioAction> BoardRadio::next_action(TimePoint now) {
  do {
    if (auto action = actions_.pop()) return action;
    while (auto from_link = link_.next_action()) {
      std::visit(overloaded{
                     [&](CommandEnded& ended) { on_command_ended(ended, now); },
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
  if (session_) session_->on_deadline(now);
  end_session();
}

// --- Events of the board -------------------------------------------------------------------------

void BoardRadio::on_command_ended(const CommandEnded& ended, TimePoint now) {
  if (!in_flight_) return;
  switch (*std::exchange(in_flight_, std::nullopt)) {
    case Purpose::scan_control:
      if (ended.status != Status::success && ended.status != Status::invalid_state)
        on_scan_refused(ended.status, now);
      return;
    case Purpose::session:
      if (session_) session_->on_command_ended(ended);
      return end_session();
    case Purpose::sweep:
      sweep_.on_command_ended(ended);
      if (!sweep_.is_done()) return;
      for (auto& [address, key] : device_keys_) key.is_waiting = false;
      return;
    case Purpose::device_key: return on_device_key(ended);
  }
}

void BoardRadio::on_scan_refused(Status status, TimePoint now) {
  is_scanning_ = !is_scanning_;
  scan_retry_at_ = now + scan_retry_pause;
  if (!scan_lines_.on_event(now)) return;
  actions_.push(Notice{
      Severity::warning,
      fmt::format("the serial board does not {} scanning for new robots ({}); the "
                  "gateway tries again every {} s",
                  is_scanning_ ? "stop" : "start", to_string(status), scan_retry_pause.count()),
      {}});
}

/// If the board refuses to add or delete a key, its table has unknown entries. The table is then
/// swept before the next key is added.
void BoardRadio::on_device_key(const CommandEnded& ended) {
  DeviceKey& key = device_keys_.at(commanded_);
  DeviceKeyUsed used{commanded_, {}};
  const bool is_success = ended.status == Status::success;
  if (key.handle) {  // the command was to delete it
    if (!is_success && !ended.is_repeat) sweep_ = {};
    key = {key.wanted, !sweep_.is_done()};
    if (key.wanted) return;  // another key is to be added
  } else {
    ByteReader data(ended.data);
    key.handle = data.read_u16_le();
    if (is_success && data.ok() && !key.is_there()) return;  // the key is not wanted any more
    if (!is_success || !data.ok()) {
      sweep_ = {};
      key.wanted.reset();
      used.problem = fmt::format("the serial board does not take its device key ({})",
                                 to_string(ended.status));
    }
  }
  if (!key.wanted) device_keys_.erase(commanded_);
  actions_.push(std::move(used));
}

void BoardRadio::on_event(const ProvisioningEvent& event, TimePoint now) {
  if (const auto* beacon = std::get_if<UnprovisionedBeacon>(&event)) return actions_.push(*beacon);
  if (!session_) return;
  const bool had_answered = session_->wants_addresses();
  const bool had_joined = session_->device_key().has_value();
  session_->on_event(event, now);
  if (!had_answered && session_->wants_addresses())
    actions_.push(DeviceAnswered{session_->elements()});
  if (!had_joined && session_->device_key()) actions_.push(DeviceJoined{*session_->device_key()});
  end_session();
}

void BoardRadio::on_message(MessageReceived& message) {
  const auto key = device_keys_.find(message.source);
  message.is_under_device_key = key != device_keys_.end() && key->second.handle == message.key;
  actions_.push(std::move(message));
}

void BoardRadio::on_link_down(LinkIsDown& down) {
  if (session_) {
    session_->fail("the BLE link went down: " + down.why);
    down.join = session_->end();
  }
  forget();
  actions_.push(std::move(down));
}

/// Forgets all requests: the board that comes up next does not know them.
void BoardRadio::forget() {
  in_flight_.reset();
  is_scan_wanted_ = is_scanning_ = false;
  scan_retry_at_.reset();
  device_.reset();
  session_.reset();
  sweep_ = {};
  device_keys_.clear();
}

// --- The next steps ------------------------------------------------------------------------------

/// Gives the board its next command. Returns true if there may be new actions.
bool BoardRadio::begin_next(TimePoint now) {
  if (!link_.is_up() || in_flight_) return false;
  // A session begins only after the last answer for an earlier one: it could take that for its own.
  if (device_ && !session_ && !begin_session(now)) return true;
  auto frame = choose();
  // If the link does not take the command, it has gone down and reports that next.
  if (frame) link_.command(std::move(*frame), now);
  return frame.has_value();
}

/// Returns the next command for an idle board.
std::optional<Bytes> BoardRadio::choose() {
  if (is_scan_wanted_ != is_scanning_ && !scan_retry_at_) {
    is_scanning_ = is_scan_wanted_;
    in_flight_ = Purpose::scan_control;
    return encode_command(is_scanning_ ? CommandOpcode::scan_start : CommandOpcode::scan_stop);
  }
  if (auto command = session_ ? session_->command() : std::nullopt) {
    in_flight_ = Purpose::session;
    return command;
  }
  return key_command();
}

/// Returns the next command about device keys. While the table has unknown entries, new keys wait.
/// The table is swept when all earlier keys are deleted.
std::optional<Bytes> BoardRadio::key_command() {
  bool is_sweep_due = !device_keys_.empty();
  for (auto& [address, key] : device_keys_) {
    if (key.is_waiting) continue;
    is_sweep_due = false;
    if (key.is_there()) continue;
    commanded_ = address;
    in_flight_ = Purpose::device_key;
    if (key.handle) return encode_command(CommandOpcode::devkey_delete, *key.handle);
    key.on_board = key.wanted;
    return encode_command(CommandOpcode::devkey_add, address, link_.board().subnet_handle,
                          *key.wanted);
  }
  const auto sweep = is_sweep_due ? sweep_.command() : std::nullopt;
  if (sweep) in_flight_ = Purpose::sweep;
  return sweep;
}

bool BoardRadio::begin_session(TimePoint now) {
  const auto pair = make_key_pair(random_);
  if (!pair) {
    device_.reset();
    actions_.push(JoinEnded{.failure = "no randomness for the keys of a new robot"});
    return false;
  }
  context_ = context_ == 0 ? 1 : 0;
  session_.emplace(*device_, *pair, context_, link_.board().version, now);
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
  return {{"sends_dropped", link.sends_dropped},
          {"sent", link.sent},
          {"send_refused", link.send_refused},
          {"tx_complete", link.tx_complete},
          {"board_drops", link.board_drops},
          {"board_restarts", link.restarts},
          {"resyncs", link.resyncs},
          {"command_timeouts", link.command_timeouts},
          {"malformed_events", link.malformed_events},
          {"other_events", link.other_events}};
}

}  // namespace slamgw::ble

// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/board_radio.hpp"

#include <fmt/format.h>

#include <utility>

namespace slamgw::ble {

void BoardRadio::perform(RadioCommand command, TimePoint now) {
  std::visit(
      overloaded{
          [&](Scan& scan) { is_scan_wanted_ = scan.is_on; },
          [&](ProvisionDevice& device) {
            device_ = device;
            is_last_context_ = false;
          },
          [&](AnswerDevice& answer) {
            if (!session_) return;
            if (answer.refusal.empty()) return session_->on_addresses(now);
            session_->fail(std::move(answer.refusal));
            end_session();
          },
          [&](UseDeviceKey& use) {
            if (use.key) device_keys_[use.address] = {*use.key, !sweep_.is_done()};
            const auto key = device_keys_.find(use.address);
            if (key != device_keys_.end()) key->second.is_unwanted = !use.key;
          },
          // Not taken: the mesh repeats it.
          [&](SendUnderDeviceKey& message) {
            const auto key = device_keys_.find(message.address);
            if (key != device_keys_.end())
              link_.send({message.address, key->second.handle, std::move(message.access)}, now);
          },
          [&](UseKeys& use) { link_.change_keys(use.keys, now); },
          [&](ClearBoard&) {
            if (!link_.clear_board(now)) actions_.push(BoardCleared{"the BLE link is down"});
          },
          [&](RestartBoard&) { link_.restart_board(now); },
          [&](UseSource& use) { link_.on_source(use.source, use.count, now); },
          [&](DelaySource& delay) { link_.on_source_delayed(delay.why); },
      },
      command);
}

std::optional<RadioAction> BoardRadio::next_action(TimePoint now) {
  while (true) {
    if (auto action = actions_.pop()) return action;
    auto from_link = link_.next_action();
    if (!from_link) return std::nullopt;
    std::visit(overloaded{
                   [&](CommandEnded& ended) {
                     on_command_ended(ended);
                     choose(now);
                   },
                   [&](ProvisioningEvent& event) { on_event(event, now); },
                   [&](MessageReceived& message) { on_message(message); },
                   [&](LinkIsUp& up) {
                     forget();
                     actions_.push(std::move(up));
                   },
                   [&](LinkIsDown& down) { on_link_down(down); },
                   [&](auto& as_it_is) { actions_.push(std::move(as_it_is)); },
               },
               *from_link);
  }
}

void BoardRadio::on_deadline(TimePoint now) {
  link_.on_deadline(now);
  if (session_) session_->on_deadline(now);
  end_session();
}

// --- What the board reports ----------------------------------------------------------------------

void BoardRadio::on_command_ended(const CommandEnded& ended) {
  if (!in_flight_) return;
  switch (*std::exchange(in_flight_, std::nullopt)) {
    case Purpose::scan_control:
      if (ended.status != Status::success && ended.status != Status::invalid_state)
        actions_.push(Notice{Severity::warning,
                             fmt::format("the serial board does not scan for new robots ({})",
                                         to_string(ended.status)),
                             {}});
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

/// A key that the board does not take or let go means that its table has unknown entries: it is
/// swept before a further key is added.
void BoardRadio::on_device_key(const CommandEnded& ended) {
  DeviceKey& key = device_keys_.at(commanded_);
  DeviceKeyUsed used{commanded_, {}};
  bool is_clear = ended.status == Status::success;
  if (key.is_unwanted) {
    is_clear = is_clear || ended.is_repeat;
  } else {
    ByteReader data(ended.data);
    key.handle = data.read_u16_le();
    is_clear = is_clear && data.ok();
    if (!is_clear)
      used.problem = fmt::format("the serial board does not take its device key ({})",
                                 to_string(ended.status));
  }
  if (!is_clear) sweep_ = {};
  if (key.is_unwanted || !is_clear) device_keys_.erase(commanded_);
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

/// The board that comes up next knows nothing of what was asked of this one.
void BoardRadio::forget() {
  in_flight_.reset();
  chosen_.reset();
  is_scan_wanted_ = is_scanning_ = false;
  device_.reset();
  session_.reset();
  sweep_ = {};
  device_keys_.clear();
}

// --- What is to be done --------------------------------------------------------------------------

bool BoardRadio::begin_next(TimePoint now) {
  const bool is_chosen = chosen_ || choose(now);
  // Not taken means that the link has gone down, which it reports next.
  if (const auto frame = std::exchange(chosen_, std::nullopt)) link_.command(*frame, now);
  return is_chosen;
}

/// Chooses what the board does next, once it has nothing to do.
bool BoardRadio::choose(TimePoint now) {
  if (!link_.is_up() || in_flight_) return false;
  // Not before the last answer for an earlier session is there, which could be taken for its own.
  if (device_ && !session_ && !begin_session(now)) return true;
  if (is_scan_wanted_ != is_scanning_) {
    is_scanning_ = is_scan_wanted_;
    return issue(
        encode_command(is_scanning_ ? CommandOpcode::scan_start : CommandOpcode::scan_stop),
        Purpose::scan_control);
  }
  return (session_ && issue(session_->command(), Purpose::session)) || issue_key_command();
}

/// The device keys that were asked for since the table became unclear wait until the others have
/// gone and the table is empty.
bool BoardRadio::issue_key_command() {
  bool is_sweep_due = !device_keys_.empty();
  for (const auto& [address, key] : device_keys_) {
    if (key.is_waiting) continue;
    is_sweep_due = false;
    commanded_ = address;
    if (key.is_unwanted)
      return issue(encode_command(CommandOpcode::devkey_delete, *key.handle), Purpose::device_key);
    if (!key.handle)
      return issue(encode_devkey_add(address, link_.board().subnet_handle, key.key),
                   Purpose::device_key);
  }
  return is_sweep_due && issue(sweep_.command(), Purpose::sweep);
}

bool BoardRadio::issue(std::optional<Bytes> frame, Purpose purpose) {
  if (!frame) return false;
  in_flight_ = purpose;
  chosen_ = std::move(frame);
  return true;
}

bool BoardRadio::begin_session(TimePoint now) {
  const auto pair = make_key_pair(random_);
  if (!pair) {
    device_.reset();
    actions_.push(JoinEnded{.failure = "no randomness for the keys of a new robot"});
    return false;
  }
  context_ = context_ == 0 ? 1 : 0;
  session_.emplace(
      ProvisioningSession::Request{{context_, device_->uuid, device_->net_key, device_->iv_index,
                                    device_->address, link_.board().version},
                                   *pair,
                                   device_->static_oob},
      now);
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

}  // namespace slamgw::ble

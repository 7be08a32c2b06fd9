// SPDX-License-Identifier: Apache-2.0
// What is to be done now; how devices join is in provisioner_joining.cpp, what nodes are told in
// provisioner_nodes.cpp, what operators want in provisioner_orders.cpp.
#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner.hpp"

#include <fmt/format.h>

#include <charconv>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/provisioning/imported_mesh.hpp"

namespace slamgw::ble {

std::optional<Uuid> parse_uuid(std::string_view text) {
  std::string digits(text);
  std::erase(digits, '-');
  Uuid uuid{};
  if (digits.size() != uuid.size() * 2) return std::nullopt;
  for (std::size_t i = 0; i < uuid.size(); ++i) {
    const char* const first = digits.data() + 2 * i;
    const auto [end, error] = std::from_chars(first, first + 2, uuid[i], 16);
    if (error != std::errc{} || end != first + 2) return std::nullopt;
  }
  return uuid;
}

Provisioner::Provisioner(const Settings& settings, RobotNames names,
                         std::optional<NodeDatabase> database, RandomSource random)
    : settings_(settings),
      names_(std::move(names)),
      random_(std::move(random)),
      ledger_(std::move(database)) {
  if (settings_.provisioning.static_oob)
    static_oob_ = parse_uuid(*settings_.provisioning.static_oob);
}

// --- Inputs --------------------------------------------------------------------------------------

void Provisioner::on_link_up(std::uint16_t subnet_handle, SerialVersion version, TimePoint now) {
  is_up_ = true;
  version_ = version;
  subnet_handle_ = subnet_handle;
  advance(now);
}

void Provisioner::on_link_down(const std::string& why, TimePoint now) {
  down_reason_ = why;
  if (!std::exchange(is_up_, false)) return;
  const bool is_restart = in_flight_ && in_flight_->errand == Errand::restart;
  in_flight_.reset();
  is_scanning_ = false;
  if (session_) {
    session_->fail("the BLE link went down: " + why);
    on_session_failed(now);
  }
  conversations_.clear();
  sweep_.reset();
  is_swept_ = false;
  if (is_restart) return;  // asked for, on the way to a new robot
  const bool needs_link =
      order_ && order_->kind != OrderKind::import_mesh && order_->kind != OrderKind::export_mesh;
  if (needs_link && order_->kind != OrderKind::reset_board)
    refuse("the BLE link went down: " + why);
  advance(now);
}

void Provisioner::on_command_ended(const CommandEnded& ended, TimePoint now) {
  if (!in_flight_) return;
  const InFlight command = *std::exchange(in_flight_, std::nullopt);
  switch (command.errand) {
    case Errand::scan_control:
      if (ended.status != Status::success && ended.status != Status::invalid_state)
        say(Severity::warning, fmt::format("the serial board does not scan for new robots ({})",
                                           to_string(ended.status)));
      break;
    case Errand::restart: break;  // it can't; the robot is taken in all the same
    case Errand::session:
      if (session_) session_->on_command_ended(ended);
      break;
    case Errand::sweep:
      if (sweep_) sweep_->on_command_ended(ended);
      break;
    case Errand::conversation: {
      const auto found = conversations_.find(command.address);
      if (found != conversations_.end()) found->second.on_command_ended(ended, now);
      break;
    }
  }
  advance(now);
}

void Provisioner::on_event(const ProvisioningEvent& event, TimePoint now) {
  if (const auto* beacon = std::get_if<UnprovisionedBeacon>(&event)) {
    candidates_.on_beacon(*beacon, now);
  } else if (session_) {
    session_->on_event(event, now);
  }
  advance(now);
}

bool Provisioner::on_message(const MessageReceived& message, TimePoint now) {
  for (auto& [address, conversation] : conversations_) {
    if (!conversation.on_message(message, now)) continue;
    advance(now);
    return true;
  }
  return false;
}

void Provisioner::on_send_refused(std::uint16_t address, const std::string& why, TimePoint now) {
  const auto found = conversations_.find(address);
  if (found != conversations_.end()) found->second.on_send_refused(why, now);
}

void Provisioner::on_heard(std::uint16_t address, TimePoint now) {
  const Node* node = database() ? database()->find_address(address) : nullptr;
  if (node == nullptr) {
    if (strangers_.size() < NodeDatabase::max_nodes) strangers_.insert(address);
    return;
  }
  Upkeep& upkeep = upkeep_[node->uuid];
  const bool was_silent = !upkeep.heard_at || now - *upkeep.heard_at > settings_.offline_after;
  upkeep.heard_at = now;
  if (was_silent && upkeep.failures > 0) upkeep.retry_at = now;  // it is in reach again
}

void Provisioner::on_iv_index(std::uint32_t iv_index, TimePoint now) {
  if (!database() || database()->iv_index == iv_index) return;
  ledger_.change().iv_index = iv_index;
  advance(now);
}

void Provisioner::on_new_mesh(const MeshKeys& keys) {
  NodeDatabase fresh;
  fresh.keys = keys;
  ledger_.begin(std::move(fresh), true);
}

void Provisioner::on_stored(const std::string& problem, TimePoint now) {
  ledger_.on_stored(problem.empty(), now);
  if (!problem.empty() && !std::exchange(was_store_problem_said_, true))
    say(Severity::error, problem + "; no robot is taken in until they can be stored");
  if (problem.empty()) was_store_problem_said_ = false;
  if (is_ordered(OrderKind::export_mesh)) {
    if (!problem.empty()) {
      refuse(problem);
    } else if (ledger_.is_saved()) {
      answer(exported_mesh_json(*database(), order_->address));
    }
  }
  if (is_ordered(OrderKind::import_mesh)) {
    if (!problem.empty()) {
      ledger_.revert(std::move(order_->before));
      refuse(problem);
    } else if (ledger_.is_saved()) {
      if (!order_->before) actions_.push(UseKeys{database()->keys});
      actions_.push(NodesChanged{});
      answer(fmt::format(R"({{"nodes":{}}})", database()->nodes.size()));
    }
  }
  advance(now);
}

// --- What is to be done --------------------------------------------------------------------------

void Provisioner::advance(TimePoint now) {
  if (order_ && now >= order_->due) on_order_due(now);
  close_permit(now);
  if (is_up_ && database()) {
    follow_session(now);
    follow_conversations(now);
    choose_next(now);
    begin_conversations(now);
  }
  write_ledger(now);
  if (is_up_) issue_next_command(now);
}

void Provisioner::close_permit(TimePoint now) {
  if (permit_.on_time(now)) say(Severity::notice, "new robots may not join any more");
}

void Provisioner::write_ledger(TimePoint now) {
  if (const NodeDatabase* changed = ledger_.take_write(now)) actions_.push(StoreMesh{*changed});
}

void Provisioner::follow_session(TimePoint now) {
  if (session_) {
    session_->on_deadline(now);
    if (session_->wants_addresses()) keep_addresses(now);
    if (session_->device_key()) on_joined(now);
    if (session_->state() == ProvisioningSession::State::succeeded) {
      session_.reset();
    } else if (session_->state() == ProvisioningSession::State::failed) {
      on_session_failed(now);
    }
  }
  // Not before the last answer for an earlier session is there, which could be taken for its own.
  const bool is_free = !session_ && !in_flight_;
  if (is_free && chosen_ && !chosen_->needs_restart && ledger_.is_saved()) begin_session(now);
}

void Provisioner::follow_conversations(TimePoint now) {
  for (auto next = conversations_.begin(); next != conversations_.end();) {
    const auto found = next++;
    NodeConfiguration& conversation = found->second;
    conversation.on_deadline(now);
    if (auto access = conversation.take_message(now))
      actions_.push(SendUnderDeviceKey{conversation.address(), conversation.devkey_handle(),
                                       std::move(*access)});
    if (conversation.state() == NodeConfiguration::State::running) continue;
    NodeConfiguration ended = std::move(conversation);
    conversations_.erase(found);
    end_conversation(std::move(ended), now);
  }
}

bool Provisioner::issue(std::optional<Bytes> frame, InFlight errand) {
  if (!frame) return false;
  in_flight_ = errand;
  actions_.push(BoardCommand{std::move(*frame)});
  return true;
}

void Provisioner::issue_next_command(TimePoint) {
  if (in_flight_) return;
  if (wants_scan() != is_scanning_) {
    is_scanning_ = !is_scanning_;
    issue(encode_command(is_scanning_ ? CommandOpcode::scan_start : CommandOpcode::scan_stop),
          {Errand::scan_control});
    return;
  }
  if (chosen_ && chosen_->needs_restart && ledger_.is_saved() && conversations_.empty()) {
    chosen_->needs_restart = false;
    issue(encode_command(CommandOpcode::radio_reset), {Errand::restart});
    return;
  }
  if (session_ && issue(session_->command(), {Errand::session})) return;
  if (sweep_ && issue(sweep_->command(), {Errand::sweep})) return;
  for (const auto& [address, conversation] : conversations_)
    if (issue(conversation.command(), {Errand::conversation, address})) return;
}

bool Provisioner::wants_scan() const {
  if (session_ || chosen_) return false;
  if (is_ordered(OrderKind::scan) || is_ordered(OrderKind::provision)) return true;
  return (settings_.provisioning.enabled || permit_.is_open()) && database() != nullptr &&
         !is_guest();
}

std::optional<TimePoint> Provisioner::deadline() const {
  std::optional<TimePoint> next = ledger_.deadline();
  if (order_) next = earlier(next, order_->due);
  next = earlier(next, permit_.deadline());
  if (!is_up_ || !database()) return next;
  if (session_) next = earlier(next, session_->deadline());
  for (const auto& [address, conversation] : conversations_)
    next = earlier(next, conversation.deadline());
  next = earlier(next, next_configuration());
  return next;
}

void Provisioner::say(Severity severity, std::string text, std::string robot) {
  actions_.push(Notice{severity, std::move(text), std::move(robot)});
}

}  // namespace slamgw::ble

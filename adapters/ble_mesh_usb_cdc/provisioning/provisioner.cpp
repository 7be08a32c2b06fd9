// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner.hpp"

#include <fmt/format.h>

#include <utility>

namespace slamgw::ble {

Provisioner::Provisioner(const Settings& settings, Radio& radio, const LinkState& link,
                         MeshActions& actions, std::string gateway, RobotNames names,
                         std::optional<NodeDatabase> database, RandomSource random)
    : random_(std::move(random)),
      nodes_(settings, std::move(names), std::move(database)),
      order_(actions),
      shared_{settings, radio, link, nodes_, order_, actions, random_},
      lives_(shared_),
      admission_(shared_),
      refresh_(shared_),
      survey_(shared_),
      conversations_(shared_, admission_, refresh_, survey_),
      orders_(shared_, admission_, conversations_, refresh_, survey_, std::move(gateway)) {}

// --- Inputs --------------------------------------------------------------------------------------

void Provisioner::on_link_up(const LinkIsUp& up, TimePoint now) {
  lives_.on_link_up(up);
  admission_.on_link_up(now);
  refresh_.on_link_up();
  advance(now);
}

void Provisioner::on_link_down(const LinkIsDown& down, TimePoint now) {
  is_scanning_ = false;
  admission_.on_link_down(down, now);
  conversations_.on_link_down();
  survey_.on_link_down();
  if (down.is_restart) return;  // on purpose: orders go on when the link is up again
  orders_.on_link_down();
  advance(now);
}

void Provisioner::on_event(const ProvisionerEvent& event, TimePoint now) {
  std::visit(overloaded{
                 [&](const KeysWanted&) { begin_mesh(now); },
                 [&](const SourceWanted& wanted) { lives_.on_source_wanted(wanted, now); },
                 [&](const UnprovisionedBeacon& beacon) {
                   admission_.candidates().on_beacon(beacon, now);
                   conversations_.on_beacon(beacon.uuid, now);
                 },
                 [&](const DeviceAnswered& answered) { admission_.on_answered(answered); },
                 [&](const DeviceJoined& joined) { admission_.on_joined(joined.device_key, now); },
                 [&](const DeviceHadJoined& joined) { admission_.on_had_joined(joined, now); },
                 [&](const JoinEnded& ended) { admission_.on_join_ended(ended, now); },
                 [&](const DeviceKeyUsed& used) { conversations_.on_key_used(used, now); },
                 [&](const RadioCleared& cleared) { orders_.on_radio_cleared(cleared.problem); },
             },
             event);
  advance(now);
}

bool Provisioner::on_message(const MessageReceived& message, TimePoint now) {
  if (!conversations_.on_message(message, now)) return false;
  advance(now);
  return true;
}

void Provisioner::on_iv_index(std::uint32_t iv_index, TimePoint now) {
  if (!nodes_.database() || nodes_.database()->iv_index == iv_index) return;
  nodes_.change().iv_index = iv_index;
  advance(now);
}

/// The radio gets the keys when they are on disk. While an import is being stored, it gets those.
void Provisioner::begin_mesh(TimePoint now) {
  if (nodes_.database() != nullptr || nodes_.is_beginning()) return;
  const auto keys = shared_.make_keys();
  keys ? nodes_.begin(*keys) : shared_.radio_.on_keys_failed(ProvisionerPart::no_randomness, now);
}

void Provisioner::on_stored(const std::string& problem, TimePoint now) {
  const bool was_beginning = nodes_.is_beginning();
  nodes_.on_stored(problem.empty(), now);
  if (was_beginning)
    return problem.empty() ? shared_.radio_.change_keys(radio_keys(*nodes_.database()), now)
                           : shared_.radio_.on_keys_failed(problem, now);
  if (!problem.empty() && !is_store_problem_known_)
    shared_.notify(Severity::error, problem + "; no robot joins until they can be stored");
  is_store_problem_known_ = !problem.empty();
  orders_.on_stored(problem, now);
  lives_.on_stored(problem, now);
  advance(now);
}

void Provisioner::on_order(std::uint64_t id, const BleOrder& order, TimePoint now) {
  orders_.on_order(id, order, now);
  advance(now);
}

// --- The next steps ------------------------------------------------------------------------------

void Provisioner::advance(TimePoint now) {
  orders_.on_deadline(now);
  orders_.begin_waiting(now);
  if (admission_.permit().on_time(now))
    shared_.notify(Severity::notice, "new robots may not join any more");
  refresh_.advance(!admission_.is_idle(), now);
  if (shared_.link_.is_up && nodes_.database()) {
    admission_.advance(now);
    conversations_.continue_all(now);
    orders_.begin_waiting(now);
    admission_.choose_next(
        [this](const Node& node) { return conversations_.is_talking_with(node); }, now);
    conversations_.begin_due(now);
  }
  if (const NodeDatabase* changed = nodes_.take_write(now))
    shared_.actions_.push(StoreMesh{*changed, nodes_.is_beginning()});
  if (shared_.link_.is_up) scan_or_restart(now);
}

void Provisioner::scan_or_restart(TimePoint now) {
  if (admission_.wants_scan() != is_scanning_) {
    is_scanning_ = !is_scanning_;
    shared_.radio_.scan(is_scanning_);
  }
  if (conversations_.is_idle() && admission_.is_idle() && conversations_.take_restart())
    shared_.radio_.restart(now);
}

std::optional<TimePoint> Provisioner::deadline() const {
  const std::optional<TimePoint> next =
      earlier(earlier(nodes_.deadline(), order_.deadline()), admission_.permit().deadline());
  if (!shared_.link_.is_up || !nodes_.database()) return next;
  return earlier(next, conversations_.deadline());
}

}  // namespace slamgw::ble

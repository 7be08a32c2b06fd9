// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/admission.hpp"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <boost/algorithm/string/predicate.hpp>
#include <tuple>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"
#include "daemon/core/bytes.hpp"

namespace slamgw::ble {

namespace {

constexpr const char* may_have_joined =
    "it was joining when the gateway ended, and may be in the mesh without the gateway knowing its "
    "key; if `slam-gatewayctl ble scan` does not show it, reset it by hand";

bool is_there(const Candidate& candidate, TimePoint now) {
  return now - candidate.last_heard <= Candidates::max_silence;
}

}  // namespace

Duration pause_after(int failures) {
  Duration pause = Candidates::first_pause;
  for (int i = 1; i < failures && pause < Candidates::max_pause; ++i) pause *= 2;
  return std::min(pause, Candidates::max_pause);
}

void Candidates::on_beacon(const UnprovisionedBeacon& beacon, TimePoint now) {
  auto known = candidates_.find(beacon.uuid);
  if (known == candidates_.end()) {
    if (candidates_.size() >= max_candidates)
      candidates_.erase(std::ranges::min_element(
          candidates_, {}, [](const auto& entry) { return entry.second.last_heard; }));
    known = candidates_.try_emplace(beacon.uuid).first;
    known->second.uuid = beacon.uuid;
    known->second.first_heard = now;
  }
  known->second.rssi_dbm = beacon.rssi_dbm;
  known->second.last_heard = now;
}

void Candidates::on_failure(const Uuid& uuid, TimePoint now) {
  const auto known = candidates_.find(uuid);
  if (known == candidates_.end()) return;
  known->second.not_before = now + pause_after(++known->second.failures);
}

void Candidates::on_elements(const Uuid& uuid, std::uint8_t elements) {
  const auto known = candidates_.find(uuid);
  if (known != candidates_.end()) known->second.elements = elements;
}

const Candidate* Candidates::find(const Uuid& uuid, TimePoint now) const {
  const auto known = candidates_.find(uuid);
  if (known == candidates_.end() || !is_there(known->second, now)) return nullptr;
  return &known->second;
}

const Candidate* Candidates::next(const Filter& is_wanted, TimePoint now) const {
  const Candidate* best = nullptr;
  const auto rank = [](const Candidate& candidate) {
    return std::tuple(candidate.failures, candidate.first_heard);
  };
  for (const auto& [uuid, candidate] : candidates_) {
    if (now < candidate.not_before || !is_there(candidate, now) || !is_wanted(candidate)) continue;
    if (best == nullptr || rank(candidate) < rank(*best)) best = &candidate;
  }
  return best;
}

std::vector<Candidate> Candidates::all(TimePoint now) const {
  std::vector<Candidate> all;
  for (const auto& [uuid, candidate] : candidates_)
    if (is_there(candidate, now)) all.push_back(candidate);
  return all;
}

void JoinPermit::open(std::chrono::seconds time, std::string robot, TimePoint now) {
  until_ = now + std::min<std::chrono::seconds>(time, PermitJoinOrder::longest);
  if (robot != robot_) named_.reset();
  robot_ = std::move(robot);
}

bool JoinPermit::on_time(TimePoint now) {
  if (!until_ || now < *until_) return false;
  close();
  return true;
}

bool JoinPermit::admits(const Uuid& uuid) const {
  return is_open() && (robot_.empty() || named_.value_or(uuid) == uuid);
}

void JoinPermit::on_chosen(const Uuid& uuid) {
  if (!is_open()) return;
  if (!robot_.empty()) named_ = uuid;
  if (under_way_.insert(uuid).second) note("joining", uuid, robot_, {});
}

void JoinPermit::on_joined(const Uuid& uuid, const std::string& robot) {
  if (!under_way_.contains(uuid)) return;
  note("joined", uuid, robot, {});
  if (named_ != uuid) return;
  named_.reset();
  close();  // the name is given
}

void JoinPermit::on_configured(const Uuid& uuid, const std::string& robot) {
  if (under_way_.erase(uuid) > 0) note("configured", uuid, robot, {});
}

void JoinPermit::on_failed(const Uuid& uuid, const std::string& why) {
  if (under_way_.erase(uuid) == 0) return;
  note("failed", uuid, {}, why);
  if (named_ == uuid) named_.reset();
}

void JoinPermit::note(std::string_view what, const Uuid& uuid, std::string robot, std::string why) {
  if (events_.size() >= max_events) events_.pop_front();
  events_.push_back({++last_number_, what, uuid, std::move(robot), std::move(why)});
}

std::string JoinPermit::json(std::uint64_t after, TimePoint now) const {
  const Duration left = until_ ? std::max(*until_ - now, Duration::zero()) : Duration::zero();
  nlohmann::ordered_json out{
      {"seconds_left", std::chrono::ceil<std::chrono::seconds>(left).count()},
      {"under_way", under_way_.size()},
      {"last", last_number_},
      {"events", nlohmann::ordered_json::array()}};
  for (const Event& event : events_) {
    if (event.number <= after) continue;
    out["events"].push_back({{"number", event.number},
                             {"event", event.what},
                             {"uuid", to_hex(event.uuid)},
                             {"robot", event.robot},
                             {"why", event.why}});
  }
  return out.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

Admission::Admission(const ProvisionerPart& shared) : ProvisionerPart(shared) {
  if (const auto& digits = settings_.provisioning.static_oob) static_oob_ = parse_uuid(*digits);
}

void Admission::on_start() {
  if (nodes_.database() == nullptr) return;
  for (const Node& node : nodes_.database()->nodes) {
    if (!node.is_joining) continue;
    const std::string id = nodes_.id_of(node.address);
    nodes_.history(node.uuid).problem = may_have_joined;
    notify(Severity::warning,
           fmt::format("{} (UUID {}): {}", id, to_hex(node.uuid), may_have_joined), id);
  }
}

void Admission::on_stop() {
  is_stopping_ = true;
  if (chosen_) on_not_joined(*std::exchange(chosen_, std::nullopt));
  if (joining_) radio_.break_off_join("slam-gatewayd is stopping");
}

/// Takes back that the device may have joined.
void Admission::on_not_joined(const Uuid& uuid) {
  const Node* node = nodes_.find(uuid);
  if (node != nullptr && node->is_joining) nodes_.change().find(uuid)->is_joining = false;
}

void Admission::on_link_down(const LinkIsDown& down, TimePoint now) {
  if (down.join) return on_join_ended(*down.join, now);
  if (joining_) chosen_ = std::exchange(joining_, std::nullopt);  // the radio had not begun
  if (chosen_ && order_.is(OpenOrder::Kind::provision, *chosen_))
    chosen_.reset();  // the order ends with the link
}

bool Admission::wants_scan() const {
  if (!is_idle()) return false;
  if (order_ && order_->kind <= OpenOrder::Kind::remove) return true;
  return is_open() && nodes_.database() != nullptr && !nodes_.is_guest();
}

// --- The next device -----------------------------------------------------------------------------

void Admission::choose_next(const IsBusy& is_busy, TimePoint now) {
  // Beacons come again and again: a device that is not due now is considered with its next beacon.
  if (!is_idle() || is_stopping_ || order_.is(OpenOrder::Kind::scan)) return;
  // A new device would get the keys that the others are giving up.
  const auto& refresh = nodes_.database()->refresh;
  if (refresh && refresh->step == RefreshStep::switching) return;
  if (order_.is(OpenOrder::Kind::provision)) {
    const Candidate* ordered = candidates_.find(order_->uuid, now);
    if (ordered != nullptr && reserve(*ordered, order_->robot, now))
      order_->due = now + order_time_limit;
    return;
  }
  const Candidate* next = candidates_.next(
      [&](const Candidate& candidate) { return is_wanted(candidate, is_busy, now); }, now);
  if (next == nullptr) return;
  const Uuid uuid = next->uuid;
  if (!reserve(*next, permit_.is_open() ? permit_.robot() : std::string(), now)) return;
  permit_.on_chosen(uuid);
}

bool Admission::is_wanted(const Candidate& candidate, const IsBusy& is_busy, TimePoint now) const {
  if (!is_open() || nodes_.is_guest()) return false;
  if (nodes_.database()->was_removed(candidate.uuid)) return false;
  if (permit_.is_open() && !permit_.admits(candidate.uuid)) return false;
  const Node* node = nodes_.find(candidate.uuid);
  // The node was reset by hand, unless the beacon is spoofed: then the real node is still heard.
  if (node != nullptr && node->state != NodeState::reserved)
    return now - up_since_ >= reset_silence && was_silent(*node, reset_silence, now) &&
           !is_busy(*node);
  const auto& prefixes = settings_.provisioning.uuid_prefixes;
  return prefixes.empty() || std::ranges::any_of(prefixes, [&](const std::string& prefix) {
           return boost::istarts_with(to_hex(candidate.uuid), prefix);
         });
}

bool Admission::was_silent(const Node& node, Duration silence, TimePoint now) const {
  const auto is_past = [&](const std::optional<TimePoint>& when) {
    return !when || now - *when >= silence;
  };
  const NodeHistory* history = nodes_.find_history(node.uuid);
  return history == nullptr || (is_past(history->heard_at) && is_past(history->joined_at));
}

/// A robot that was reset says nothing from its old address, so another device has taken its UUID.
void Admission::on_heard(std::uint16_t address) {
  if (nodes_.database() == nullptr || nodes_.find(address) != nullptr) return;
  for (const Node& node : nodes_.database()->nodes) {
    const NodeHistory* history = nodes_.find_history(node.uuid);
    if (history == nullptr || history->left_address != address) continue;
    nodes_.history(node.uuid).left_address = 0;
    const std::string id = nodes_.id_of(node.address);
    notify(Severity::warning,
           fmt::format("two devices have the UUID {}: {} joined with it at 0x{:04x}, but the robot "
                       "at 0x{:04x} was not reset; give one of them another UUID and reset it by "
                       "hand",
                       to_hex(node.uuid), id, node.address, address),
           id);
  }
}

bool Admission::reserve(const Candidate& candidate, const std::string& name, TimePoint now) {
  const Node* known = nodes_.find(candidate.uuid);
  if (!name.empty() && nodes_.is_elsewhere(name, known ? known->address : 0)) {
    if (permit_.robot() == name) permit_.close();
    refuse(candidate.uuid, name + " is another robot already", now);
    return false;
  }
  const bool has_room = known != nullptr || make_room();
  const std::uint8_t elements =
      known ? std::max(candidate.elements, known->elements) : candidate.elements;
  const auto address = has_room ? nodes_.address_for(candidate.uuid, elements, name) : std::nullopt;
  if (address) {
    keep(candidate.uuid, *address, elements, name);
    return true;
  }
  refuse(candidate.uuid,
         has_room ? "no unicast address is left for it"
                  : fmt::format("the mesh has {} nodes already", NodeDatabase::max_nodes),
         now);
  return false;
}

/// Puts off the device's next attempt, and ends the order for it.
void Admission::fail(const Uuid& uuid, const std::string& why, TimePoint now) {
  permit_.on_failed(uuid, why);
  candidates_.on_failure(uuid, now);
  if (order_.is(OpenOrder::Kind::provision, uuid)) order_.refuse(why);
}

void Admission::refuse(const Uuid& uuid, const std::string& why, TimePoint now) {
  notify(Severity::warning, fmt::format("the device {} did not join: {}", to_hex(uuid), why));
  fail(uuid, why, now);
}

void Admission::remove(Uuid uuid) {
  candidates_.erase(uuid);
  permit_.on_failed(uuid, "it was removed");
  nodes_.remove(uuid);
}

/// The address is the device's from now on. The device joins as soon as this is on disk.
void Admission::keep(const Uuid& uuid, std::uint16_t address, std::uint8_t elements,
                     const std::string& name) {
  NodeDatabase& database = nodes_.change();
  Node* node = database.find(uuid);
  if (node == nullptr) {
    node = &database.nodes.emplace_back();
    node->uuid = uuid;
  }
  if (node->state == NodeState::reserved) {
    node->address = address;
    node->elements = elements;
  } else {  // the node stays as it was until it has joined: the beacon may be spoofed
    node->name = nodes_.id_of(node->address);
    node->new_address = address;
    node->new_elements = elements;
  }
  node->is_joining = true;
  if (!name.empty()) {
    for (Node& other : database.nodes)  // a device that did not join
      if (other.state == NodeState::reserved && other.name == name) other.name.clear();
    node->name = name;
    database.forget_removed(uuid);
  }
  const bool is_next_free = name.empty() && nodes_.configured_name(address) == nullptr;
  if (is_next_free && address >= database.next_address)
    database.next_address = static_cast<std::uint16_t>(address + elements);
  chosen_ = uuid;
}

bool Admission::make_room() {
  const auto& nodes = nodes_.database()->nodes;
  if (nodes.size() < NodeDatabase::max_nodes) return true;
  const auto unfinished = std::ranges::find(nodes, NodeState::reserved, &Node::state);
  if (unfinished == nodes.end()) return false;
  const Uuid uuid = unfinished->uuid;
  nodes_.remove(uuid);
  nodes_.change().forget_removed(uuid);  // no operator has removed it
  return true;
}

// --- The device that joins -----------------------------------------------------------------------

void Admission::advance(TimePoint now) {
  if (joining_ && elements_ != 0) keep_addresses(now);
  if (chosen_ && !joining_ && nodes_.is_saved()) begin_joining(now);
}

void Admission::begin_joining(TimePoint now) {
  const Uuid uuid = *std::exchange(chosen_, std::nullopt);
  const Node* node = nodes_.find(uuid);
  if (node == nullptr) return fail(uuid, "it can't join now", now);
  const NodeDatabase& database = *nodes_.database();
  joining_ = uuid;
  elements_ = 0;
  nodes_.history(uuid).problem.clear();
  radio_.provision(
      {uuid, database.keys.net_key, database.iv_index, node->joining_address(), static_oob_});
}

void Admission::keep_addresses(TimePoint now) {
  const std::uint8_t elements = elements_;
  const auto answer = [&](const std::string& refusal) {
    elements_ = 0;
    radio_.answer_device(refusal, now);
  };
  const Node* node = nodes_.find(*joining_);
  candidates_.on_elements(*joining_, elements);
  if (node == nullptr) return answer("an operator removed it");
  const std::uint16_t address = node->joining_address();
  if (!is_address_free(*nodes_.database(), address, elements, nodes_.taken_addresses(), node->uuid))
    return answer(
        fmt::format("its {} elements need as many addresses in a row, which 0x{:04x} does not "
                    "have; it gets others at the next attempt",
                    elements, address));
  if (const std::uint32_t reserved = node->joining_elements(); reserved != elements) {
    NodeDatabase& database = nodes_.change();
    Node& changed = *database.find(*joining_);
    (changed.new_address != 0 ? changed.new_elements : changed.elements) = elements;
    const bool is_next_free = address + reserved == database.next_address;
    if (is_next_free) database.next_address = static_cast<std::uint16_t>(address + elements);
  }
  if (nodes_.is_saved()) answer({});
}

/// The board has taken the device in without this daemon: it needs its host no more once it has the
/// shared secret.
void Admission::on_had_joined(const DeviceHadJoined& joined, TimePoint now) {
  const NodeDatabase* database = nodes_.database();
  if (database == nullptr || joined.net_key != database->keys.net_key) return;
  const auto node = std::ranges::find_if(database->nodes, [&](const Node& each) {
    const bool is_awaited = each.state == NodeState::reserved || each.new_address != 0;
    return is_awaited && each.joining_address() == joined.address;
  });
  if (node != database->nodes.end()) take_in(Uuid{node->uuid}, joined.device_key, now);
}

void Admission::take_in(const Uuid& uuid, const std::optional<Key>& device_key, TimePoint now) {
  if (nodes_.find(uuid) == nullptr) return;
  NodeDatabase& database = nodes_.change();
  Node& node = *database.find(uuid);
  node.is_joining = false;
  const std::uint16_t left_address = node.new_address != 0 ? node.address : std::uint16_t{0};
  if (node.new_address != 0) {
    database.retire(node.address, node.elements, Uuid{});
    node.address = std::exchange(node.new_address, std::uint16_t{0});
    node.elements = std::exchange(node.new_elements, std::uint8_t{0});
  }
  node.device_key = device_key;
  node.state = NodeState::provisioned;
  node.ttl.reset();
  node.applied.reset();
  const bool has_new_keys = database.refresh && database.refresh->step == RefreshStep::finishing;
  node.refreshed = has_new_keys ? RefreshStep::finishing : RefreshStep::none;
  candidates_.erase(node.uuid);
  NodeHistory& history = nodes_.history(node.uuid);
  history = NodeHistory{.joined_at = now,
                        .has_restarted_radio = history.has_restarted_radio,
                        .left_address = left_address};
  nodes_.announce_change();
  const std::string id = nodes_.id_of(node.address);
  notify(
      Severity::notice,
      fmt::format("{} is in the mesh, at 0x{:04x}, UUID {}", id, node.address, to_hex(node.uuid)),
      id);
  permit_.on_joined(node.uuid, id);
  warn_of_replay_list(node);
}

void Admission::warn_of_replay_list(const Node& node) {
  std::size_t sources = 0;
  for (const Node& each : nodes_.database()->nodes)
    sources += each.state == NodeState::reserved ? 0 : each.elements;
  if (sources <= radio_.max_senders()) return;
  const std::string id = nodes_.id_of(node.address);
  notify(Severity::warning,
         fmt::format("{} may not be heard: a stock serial board remembers {} sources, and the mesh "
                     "has {}",
                     id, radio_.max_senders(), sources),
         id);
}

/// Forgets a device that may have joined. It may have its address until it is reset, so others get
/// that address last. A device that an operator or the configuration named keeps name and address.
void Admission::release(const Uuid& uuid) {
  candidates_.erase(uuid);  // until it is heard again
  const Node* node = nodes_.find(uuid);
  if (node == nullptr || node->state != NodeState::reserved || !node->name.empty()) return;
  if (nodes_.configured_name(node->address) != nullptr) return;
  nodes_.remove(uuid);
  nodes_.change().forget_removed(uuid);
}

void Admission::on_join_ended(const JoinEnded& ended, TimePoint now) {
  if (!joining_) return;
  const Uuid uuid = *std::exchange(joining_, std::nullopt);
  const Node* node = nodes_.find(uuid);
  const bool is_in_mesh =
      node != nullptr && node->state != NodeState::reserved && node->new_address == 0;
  if (ended.failure.empty() || is_in_mesh) return;
  fail(uuid, ended.failure, now);
  if (!ended.may_have_joined) on_not_joined(uuid);
  const Candidate* candidate = candidates_.find(uuid, now);
  const Duration pause = pause_after(candidate ? candidate->failures : 1);
  const std::string what_next =
      ended.is_key_lost ? std::string("reset it by hand, then it can join again")
      : is_stopping_    ? std::string("the next attempt comes after the next start")
      : ended.may_have_joined
          ? std::string("the next attempt comes when it is heard again")
          : fmt::format("the next attempt is in {} s if it is still heard",
                        std::chrono::duration_cast<std::chrono::seconds>(pause).count());
  if (ended.may_have_joined) release(uuid);
  notify(Severity::warning, fmt::format("the device {} did not join: {}; {}{}", to_hex(uuid),
                                        ended.failure, what_next, ended.remark));
}

}  // namespace slamgw::ble

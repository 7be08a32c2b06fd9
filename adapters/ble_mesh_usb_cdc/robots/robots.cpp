// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/robots/robots.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <boost/algorithm/string/replace.hpp>
#include <vector>

namespace slamgw::ble {

Report will_report(const WillSettings& will, std::string_view robot) {
  return {.mesh = Mesh::ble,
          .robot = std::string(robot),
          .topic = boost::replace_all_copy(will.topic, "{id}", robot),
          .payload = to_bytes(will.message),
          .qos = Qos::at_least_once,
          .retain = false,
          .receipt = {Mesh::ble, 0},
          .is_will = true};
}

namespace {

constexpr std::chrono::seconds sign_of_life_interval{1};
/// A robot that several gateways hear is served by one of them within this time after it came.
constexpr std::chrono::seconds newly_online{10};

template <class Map>
auto find_id(Map& robots, std::string_view id) -> decltype(&robots.begin()->second) {
  for (auto& [address, robot] : robots)
    if (robot.id == id) return &robot;
  return nullptr;
}

}  // namespace

// --- The robots and their names ------------------------------------------------------------------

Robot* Robots::at(std::uint16_t source, TimePoint now) {
  const Node* node = nodes_.find_joined(source);
  const std::uint16_t address = node != nullptr ? node->address : source;
  if (Robot* const known = find(address)) return known;
  if (!make_room(now)) {
    if (const auto count = full_throttle_.on_event(now))
      warn(
          fmt::format("{} message(s) from robots beyond the {} that the BLE mesh has room "
                      "for were ignored",
                      *count, max_robots));
    return nullptr;
  }
  return &add(address, nodes_.id_of(address)).first->second;
}

/// Forgets the address that was silent for longest if all places are taken. Nodes and robots of the
/// configuration stay. Octets that are lost on a serial line can make up addresses. Returns false
/// if there is no room.
bool Robots::make_room(TimePoint now) {
  if (robots_.size() < max_robots) return true;
  auto oldest = robots_.end();
  for (auto each = robots_.begin(); each != robots_.end(); ++each) {
    const Robot& robot = each->second;
    const bool stays =
        robot.is_node || robot.is_expected() || nodes_.configured_name(robot.address) != nullptr;
    if (stays || (oldest != robots_.end() && robot.last_heard >= oldest->second.last_heard))
      continue;
    oldest = each;
  }
  if (oldest == robots_.end()) return false;
  leave_name(oldest->second, "the robot has been silent, and others need its place", now);
  emit(SessionEvicted{Mesh::ble, oldest->second.id});
  robots_.erase(oldest);
  return true;
}

Robot* Robots::find(std::uint16_t address) {
  const auto found = robots_.find(address);
  return found == robots_.end() ? nullptr : &found->second;
}

Robot* Robots::find(std::string_view id) { return find_id(robots_, id); }

const Robot* Robots::find(std::string_view id) const { return find_id(robots_, id); }

void Robots::on_start() {
  on_nodes_changed(TimePoint{});
  add_configured();
  is_started_ = true;
}

void Robots::add_configured() {
  for (const RobotName& name : nodes_.names().configured()) {
    if (!name.ble_address) continue;
    if (nodes_.is_elsewhere(name.id, *name.ble_address)) {
      warn_of_taken_name(name.id, *name.ble_address);
      continue;
    }
    const auto [entry, is_new] = add(*name.ble_address, name.id);
    if (is_new) subscribe_known(entry->second);
  }
}

/// A robot that joined again at another address has its configured name there: no warning.
void Robots::warn_of_taken_name(const std::string& name, std::uint16_t address) {
  const Robot* holder = find(name);
  const Robot* robot = find(address);
  if (holder == nullptr || robot == nullptr) return;
  warn(fmt::format("\"robots\" gives 0x{:04x} the id {}, which the robot at 0x{:04x} has: it "
                   "goes by {}; give 0x{:04x} another id in \"robots\", or remove it (ble "
                   "remove), and reload",
                   address, name, holder->address, robot->id, holder->address),
       robot->id);
}

void Robots::on_nodes_changed(TimePoint now) {
  for (auto next = robots_.begin(); next != robots_.end();) {
    const auto entry = next++;
    Robot& robot = entry->second;
    const bool is_node = nodes_.find_joined(robot.address) != nullptr;
    const bool is_the_same = is_node && nodes_.id_of(robot.address) == robot.id;
    const bool is_elsewhere = nodes_.is_elsewhere(robot.id, robot.address);
    if ((!robot.is_node && !is_node && !is_elsewhere) || is_the_same) continue;
    leave_name(
        robot,
        is_elsewhere ? "the robot joined the mesh again" : "the robot was removed from the mesh",
        now);
    robots_.erase(entry);
  }
  if (nodes_.database() == nullptr) return;
  for (const Node& node : nodes_.database()->nodes) {
    if (node.state == NodeState::reserved) continue;
    if (!robots_.contains(node.address) && !make_room(now)) continue;
    const auto [entry, is_new] = add(node.address, nodes_.id_of(node.address));
    Robot& robot = entry->second;
    robot.is_node = true;
    robot.sent_ttl = node.sent_ttl();
    if (is_new) subscribe_known(robot);
  }
}

void Robots::on_names(TimePoint now) {
  std::vector<Robot*> renamed;
  for (auto& [address, robot] : robots_)
    if (nodes_.id_of(address) != robot.id) renamed.push_back(&robot);
  // All robots leave their old names before one takes a new name: two may have swapped names.
  for (Robot* robot : renamed) leave_name(*robot, "the robot was renamed", now);
  for (Robot* robot : renamed) {
    const bool was_only_configured = !robot->is_node && !robot->announced;
    if (was_only_configured) {
      robots_.erase(std::uint16_t{robot->address});
    } else {
      take_name(*robot, nodes_.id_of(robot->address), now);
    }
  }
  add_configured();
  const Bans& bans = nodes_.names().bans();
  for (auto& [address, robot] : robots_)
    if (bans.has(robot.id)) apply_ban(robot, now);
}

/// The gateway ignores a banned robot's answers, so commands to it can't be acknowledged.
void Robots::apply_ban(Robot& robot, TimePoint now) {
  robot.is_online = robot.is_presence_unconfirmed = robot.is_deaf = robot.is_deaf_now = false;
  downlink_.end_all(robot, "the robot is banned (slam-gatewayctl unban)", now);
  if (robot.is_shown()) announce(robot, Presence::offline);
}

void Robots::leave_name(Robot& robot, const std::string& why, TimePoint now) {
  if (robot.is_shown()) announce(robot, Presence::offline);
  downlink_.end_all(robot, why, now);
  emit(UnsubscribeRequest{Mesh::ble, robot.id, topics_.command_filter(robot.id)});
}

/// With another name the robot counts as one that has just come.
void Robots::take_name(Robot& robot, std::string id, TimePoint now) {
  robot.id = std::move(id);
  robot.announced.reset();
  robot.online_since = now;
  robot.retained_given.clear();
  robot.is_subscribed = true;
  subscribe_known(robot);
  if (robot.is_online && gate_.is_open_for(robot)) announce(robot, Presence::online);
}

// --- Presence ------------------------------------------------------------------------------------

std::uint64_t Robots::online() const {
  return static_cast<std::uint64_t>(
      std::ranges::count_if(robots_, [](const auto& entry) { return entry.second.is_online; }));
}

std::uint64_t Robots::deaf() const {
  return static_cast<std::uint64_t>(std::ranges::count_if(
      robots_, [](const auto& entry) { return entry.second.is_online && entry.second.is_deaf; }));
}

Robots::Hearing Robots::hearing() const {
  Hearing hearing;
  for (const auto& [address, robot] : robots_) {
    if (!robot.is_online || !robot.is_asking) continue;
    ++hearing.asking;
    hearing.deaf += robot.is_deaf_now ? 1 : 0;
  }
  return hearing;
}

void Robots::on_hearing(Robot& robot, bool is_deaf) {
  robot.is_deaf_now = is_deaf;
  if (std::exchange(robot.is_deaf, is_deaf) != is_deaf && robot.is_shown())
    announce(robot, Presence::online);
}

void Robots::on_link_up(TimePoint now) {
  for (auto& [address, robot] : robots_) {
    robot.is_asking = robot.is_deaf_now = false;
    for (Inbox& inbox : robot.inboxes) inbox.filter.forget_unheard();
    // Makes the broker send retained messages again, also those that the robot got live.
    if (robot.is_shown() && std::exchange(robot.misses_retained, false))
      subscribe(robot, /*is_here=*/true);
    if (robot.is_node) robot.await(now);
  }
}

void Robots::on_session_held(Robot& robot, TimePoint now) {
  if (robot.is_shown()) return;
  if (robot.is_online) {
    announce(robot, Presence::online);
  } else if (robot.is_node) {
    robot.await(now);
  }
  // A robot that came earlier got its retained messages from the gateway that served it then.
  const bool misses = std::exchange(robot.misses_retained, false);
  subscribe(robot, robot.is_online && (misses || now - robot.online_since < newly_online));
}

/// In a shared mesh the radio still hears the robot, so it stays online with its retained messages.
void Robots::on_given_up(Robot& robot) {
  robot.announced.reset();
  robot.is_online = robot.is_online && gate_.is_shared();
  robot.is_presence_unconfirmed = robot.is_deaf = robot.is_deaf_now = robot.is_asking = false;
  robot.is_subscribed = true;
}

void Robots::on_heard(Robot& robot, TimePoint now) {
  robot.last_heard = now;
  robot.is_presence_unconfirmed = false;
  if (!std::exchange(robot.is_online, true)) {
    robot.online_since = now;
    robot.retained_given.clear();
    robot.misses_retained = false;
  }
  if (!gate_.is_open_for(robot)) return;
  if (!robot.is_shown()) {
    announce(robot, Presence::online);
    return subscribe(robot, /*is_here=*/true);
  }
  if (now - robot.sign_of_life_at < sign_of_life_interval) return;
  robot.sign_of_life_at = now;
  emit(SignOfLife{Mesh::ble, robot.id});
}

void Robots::on_deadline(Robot& robot, TimePoint now) {
  if (!robot.is_expected() || now < robot.last_heard + settings_.offline_after) return;
  robot.is_online = robot.is_deaf = robot.is_deaf_now = false;
  const bool was_awaited = std::exchange(robot.is_presence_unconfirmed, false);
  const bool was_shown = robot.is_shown();
  if (was_shown || (was_awaited && gate_.is_open_for(robot))) announce(robot, Presence::offline);
  if (settings_.will && was_shown) emit(will_report(*settings_.will, robot.id));
}

void Robots::announce(Robot& robot, Presence presence) {
  robot.announced = presence;
  emit(PresenceChange{Mesh::ble, robot.id, presence, fmt::format("0x{:04x}", robot.address),
                      presence == Presence::online && robot.is_deaf});
}

// --- Subscriptions -------------------------------------------------------------------------------

/// Another gateway may serve the robot at the start, and in a shared mesh at any time. Then the
/// request must not count as a sign that the robot is here.
void Robots::subscribe_known(const Robot& robot) {
  subscribe(robot, is_started_ && gate_.is_open_for(robot));
}

void Robots::subscribe(const Robot& robot, bool is_here) {
  emit(SubscribeRequest{Mesh::ble, robot.id, topics_.command_filter(robot.id), Qos::at_least_once,
                        /*is_standing=*/!is_here});
}

void Robots::on_subscribe_result(const std::string& id, bool granted) {
  if (Robot* robot = find(id)) robot->is_subscribed = granted;
}

void Robots::on_broker_up() {
  for (auto& [address, robot] : robots_)
    if (!std::exchange(robot.is_subscribed, true)) subscribe(robot, /*is_here=*/true);
}

}  // namespace slamgw::ble

// SPDX-License-Identifier: Apache-2.0
#include "tests/fleet/shared_mesh.hpp"

#include "daemon/core/result.hpp"

namespace slamgw::fleet::test {
namespace {

constexpr milliseconds period{200};
constexpr milliseconds first_repeat{280};  // with TTL 4
constexpr milliseconds longest_exchange{60000};
constexpr milliseconds time_on_air{10};
constexpr int usual_level_db = -60;

}  // namespace

struct SharedMesh::Node {
  /// A robot's last message, as the uplink's filter remembers it.
  struct Inbox {
    std::uint64_t number = 0;
    bool is_open = false;
    std::uint64_t receipt = 0;
  };
  /// A message that was left to another gateway, as the uplink remembers it.
  struct Unserved {
    std::uint64_t number = 0;
    milliseconds first{};
    milliseconds last{};
  };
  std::string name;
  std::unique_ptr<Ownership> ownership;
  std::uint64_t process = 0;
  bool is_running = false;
  bool is_link_up = false;
  bool is_board_up = true;
  bool is_deaf = false;
  std::set<std::string> filters;  // what it wants to hear
  int connection = 0;
  std::map<int, int> level_db;
  std::map<int, Inbox> inboxes;
  std::map<int, Unserved> unserved;
  std::uint64_t last_receipt = 0;
  std::optional<milliseconds> armed;
};

SharedMesh::SharedMesh(Options options)
    : VirtualTime(options.seed),
      options_(options),
      robots_(static_cast<std::size_t>(options.robots)) {
  for (int i = 0; i < options.gateways; ++i) {
    nodes_.push_back(std::make_unique<Node>());
    nodes_.back()->name = "gw-" + std::to_string(i);
    start(i);
  }
  for (int i = 0; i < options.robots; ++i) at(milliseconds(i * 37), [this, i] { say(i); });
}

SharedMesh::~SharedMesh() = default;

milliseconds SharedMesh::delay() { return between(milliseconds(1), options_.most_delay); }

// --- Robots --------------------------------------------------------------------------------------

void SharedMesh::say(int robot) {
  Robot& who = robots_[static_cast<std::size_t>(robot)];
  ++who.number;
  who.is_open = true;
  who.began = now_;
  who.copies = 0;
  send_copy(robot, who.number);
}

void SharedMesh::send_copy(int robot, std::uint64_t number) {
  Robot& who = robots_[static_cast<std::size_t>(robot)];
  if (!who.is_open || who.number != number) return;
  const milliseconds next = who.began + first_repeat * (1 << who.copies++);
  for (const auto& node : nodes_)
    if (!chance(options_.radio_loss))
      at(now_ + time_on_air, [this, to = node.get(), robot, number] { hear(*to, robot, number); });
  if (next < who.began + longest_exchange)
    return at(next, [this, robot, number] { send_copy(robot, number); });
  at(who.began + longest_exchange, [this, robot, number] { give_up(robot, number); });
}

void SharedMesh::give_up(int robot, std::uint64_t number) {
  Robot& who = robots_[static_cast<std::size_t>(robot)];
  if (!who.is_open || who.number != number) return;
  who.longest = longest_exchange;
  say(robot);
}

void SharedMesh::on_status(int robot, std::uint64_t number) {
  Robot& who = robots_[static_cast<std::size_t>(robot)];
  if (!who.is_open || who.number != number) return;
  who.is_open = false;
  who.acknowledged.insert(number);
  who.longest = std::max(who.longest, now_ - who.began);
  at(std::max(now_, who.began + period), [this, robot] { say(robot); });
}

// --- Gateways ------------------------------------------------------------------------------------

const Ownership& SharedMesh::ownership(int gateway) const {
  return *nodes_[static_cast<std::size_t>(gateway)]->ownership;
}

void SharedMesh::start(int gateway) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  node.is_running = true;
  node.process = random_();
  node.ownership = std::make_unique<Ownership>(FleetTopics("p", node.name),
                                               Settings{Enabled::yes, node.process << 16U},
                                               [] { return std::vector<LocalRobot>{}; });
  node.filters.clear();
  input(node, [&] { node.ownership->on_board(node.is_board_up, clock()); });
  restore_link(gateway);
}

void SharedMesh::kill(int gateway) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  node.is_running = node.is_link_up = false;
  node.process = 0;
  for (int robot = 0; robot < options_.robots; ++robot) forget(node, robot);
  node.unserved.clear();
}

void SharedMesh::cut_link(int gateway) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  node.is_link_up = false;
  input(node, [&] { node.ownership->on_broker_link(false, clock()); });
}

void SharedMesh::restore_link(int gateway) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  node.is_link_up = true;
  ++node.connection;
  for (const std::string& filter : node.filters) subscribe(node, filter);
  input(node, [&] { node.ownership->on_broker_link(true, clock()); });
}

/// The broker answers.
void SharedMesh::subscribe(Node& node, const std::string& filter) {
  at(now_ + delay(), [this, &node, filter, connection = node.connection] {
    if (node.connection != connection || !node.is_link_up) return;
    input(node,
          [&] { node.ownership->on_subscribe_result(filter, SubscribeAnswer::granted, clock()); });
  });
}

void SharedMesh::set_board(int gateway, bool is_up) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  node.is_board_up = is_up;
  input(node, [&] { node.ownership->on_board(is_up, clock()); });
}

void SharedMesh::set_deaf(int gateway, bool is_deaf) {
  nodes_[static_cast<std::size_t>(gateway)]->is_deaf = is_deaf;
}

void SharedMesh::set_level(int gateway, int robot, int level_db) {
  nodes_[static_cast<std::size_t>(gateway)]->level_db[robot] = level_db;
}

/// As Uplink of the BLE mesh.
void SharedMesh::hear(Node& node, int robot, std::uint64_t number) {
  if (!node.is_running || !node.is_board_up || node.is_deaf) return;
  const std::string name = name_of(robot);
  const int level_db = node.level_db.try_emplace(robot, usual_level_db).first->second;
  input(node, [&] { node.ownership->on_heard_too(name, SignalLevel{level_db}, clock()); });
  if (node.ownership->may_serve(name, clock().mono)) return serve(node, robot, number);
  forget(node, robot);
  Node::Unserved& unserved = node.unserved[robot];
  if (unserved.number != number) unserved = {number, now_, now_};
  unserved.last = now_;
}

/// What the robot says again and again goes up now.
void SharedMesh::take_over(Node& node, int robot) {
  forget(node, robot);
  ++robots_[static_cast<std::size_t>(robot)].takeovers;
  const auto unserved = node.unserved.extract(robot);
  if (unserved.empty()) return;
  const auto& [number, first, last] = unserved.mapped();
  if (last > first && now_ - last <= last - first + milliseconds(200)) serve(node, robot, number);
}

void SharedMesh::serve(Node& node, int robot, std::uint64_t number) {
  Node::Inbox& inbox = node.inboxes[robot];
  const int others = static_cast<int>(servers(robot).size()) - 1;
  two_owners_ += others > 0 ? 1 : 0;
  const auto answer = [this, robot, number] {
    if (!chance(options_.radio_loss))
      at(now_ + time_on_air, [this, robot, number] { on_status(robot, number); });
  };
  if (inbox.number == number) return inbox.is_open ? void() : answer();
  inbox = {number, true, ++node.last_receipt};
  if (!node.is_link_up) return;  // on disk, which nobody looks at here
  const milliseconds there = now_ + delay();
  at(there, [this, robot, number] { ++robots_[static_cast<std::size_t>(robot)].arrived[number]; });
  at(there + delay(),
     [this, &node, robot, receipt = inbox.receipt, process = node.process, answer] {
       const auto known = node.inboxes.find(robot);
       if (node.process != process || known == node.inboxes.end()) return;
       Node::Inbox& now = known->second;
       if (now.receipt != receipt) return;
       if (!node.ownership->may_serve(name_of(robot), clock().mono)) return forget(node, robot);
       now.is_open = false;
       answer();
     });
}

/// Its next copy is a new message here.
void SharedMesh::forget(Node& node, int robot) {
  if (node.inboxes.erase(robot) > 0) ++robots_[static_cast<std::size_t>(robot)].ends;
}

void SharedMesh::input(Node& node, const std::function<void()>& change) {
  if (!node.is_running) return;
  change();
  while (auto action = node.ownership->next_action()) perform(node, *action);
  const auto deadline = node.ownership->deadline();
  if (!deadline) return;
  const auto since = std::chrono::ceil<milliseconds>(deadline->time_since_epoch());
  const milliseconds due = std::max(now_, since - std::chrono::hours(1));
  if (node.armed && *node.armed <= due && *node.armed >= now_) return;
  node.armed = due;
  at(due, [this, &node, due, process = node.process] {
    if (node.process != process || node.armed != due) return;
    node.armed.reset();
    input(node, [&] { node.ownership->on_deadline(clock()); });
  });
}

void SharedMesh::perform(Node& node, OwnershipAction& action) {
  const auto number_of = [](const std::string& robot) { return std::stoi(robot.substr(1)); };
  std::visit(overloaded{
                 [&](PublishNow& what) { publish(node, what.message); },
                 [&](SubscribeFleet& what) {
                   node.filters.insert(what.filter);
                   if (node.is_link_up) subscribe(node, what.filter);
                 },
                 [&](TakeOverRobot& what) { take_over(node, number_of(what.robot)); },
                 [&](GiveUpRobot& what) {
                   forget(node, number_of(what.robot));
                   if (what.is_awaited)
                     node.ownership->on_given_up(what.robot, what.to, {}, clock());
                 },
                 [](auto&) {},
             },
             action);
}

void SharedMesh::publish(Node& node, const BrokerMessage& message) {
  if (!node.is_link_up) return;
  for (const auto& each : nodes_) {
    const FleetTopics topics("p", each->name);
    const bool is_for_it = filter_matches(topics.all_filter(), message.topic) ||
                           filter_matches(topics.own_filter(), message.topic);
    if (!is_for_it || (message.qos == Qos::at_most_once && chance(options_.broker_loss))) continue;
    at(now_ + delay(), [this, to = each.get(), message, process = each->process] {
      if (to->process != process || !to->is_link_up) return;
      input(*to, [&] { to->ownership->on_broker_message(message, clock()); });
    });
  }
}

// --- Judging -------------------------------------------------------------------------------------

std::vector<int> SharedMesh::servers(int robot) const {
  std::vector<int> found;
  for (std::size_t i = 0; i < nodes_.size(); ++i)
    if (nodes_[i]->is_running && nodes_[i]->ownership->may_serve(name_of(robot), clock().mono))
      found.push_back(static_cast<int>(i));
  return found;
}

SharedMesh::Judgement SharedMesh::judge() const {
  Judgement all;
  for (const Robot& robot : robots_) {
    int doubled = 0;
    for (const std::uint64_t number : robot.acknowledged)
      all.lost += robot.arrived.contains(number) ? 0 : 1;
    for (const auto& [number, count] : robot.arrived) doubled += count - 1;
    all.messages += static_cast<int>(robot.acknowledged.size());
    all.doubled += doubled;
    all.beyond += std::max(0, doubled - robot.ends);
    all.longest =
        std::max({all.longest, robot.longest, robot.is_open ? now_ - robot.began : now_ - now_});
  }
  all.two_owners = two_owners_;
  return all;
}

}  // namespace slamgw::fleet::test

// SPDX-License-Identifier: Apache-2.0
#include "tests/fleet/fleet_world.hpp"
#include "tests/fleet/will_of.hpp"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

namespace slamgw::fleet::test {
namespace {

constexpr milliseconds pace{300};         // between two messages of a robot
constexpr milliseconds keep_alive{2000};  // a robot that is silent for longer is lost
constexpr milliseconds leftovers_after{40000};
constexpr milliseconds look_pace{20};
constexpr milliseconds presence_pace{100};
constexpr milliseconds longest_two_online{2000};  // contract
constexpr milliseconds on_air{30};
constexpr milliseconds timeout{2000};

}  // namespace

struct FleetWorld::Node {
  std::string name;
  std::unique_ptr<Ownership> ownership;
  bool is_running = false;
  bool is_paused = false;
  bool is_link_up = false;
  int side = 0;
  std::chrono::hours clock_offset{0};
  std::uint64_t process = 0;
  std::set<std::string> filters;              // what it wants to hear
  std::set<std::string> standing;             // what of that the broker knows
  milliseconds subscribed{0};                 // until then the broker is busy with the others
  std::vector<BrokerMessage> kept_by_broker;  // for when the link is up again
  int connection = 0;
  std::vector<std::function<void()>> waiting;    // what came while it was paused
  std::map<std::string, milliseconds> sessions;  // robots, and when they were heard; kept on disk
  std::map<std::string, Bytes> kept;             // what a new owner gets of them
  std::vector<BrokerMessage> stored;             // for when the link is up again
  std::optional<milliseconds> armed;
};

FleetWorld::FleetWorld(Options options) : VirtualTime(options.seed), options_(options) {
  for (int i = 0; i < options.gateways; ++i) {
    auto node = std::make_unique<Node>();
    node->name = gateway_name(i);
    node->clock_offset = std::chrono::hours(1000 + i * 7);  // clocks differ by hours
    nodes_.push_back(std::move(node));
  }
  for (int i = 0; i < options.gateways; ++i) start(i);
  robots_.resize(static_cast<std::size_t>(options.robots));
  for (int i = 0; i < options.robots; ++i) roam(i, i % options.gateways);
  look();
  look_at_presence();
}

FleetWorld::~FleetWorld() = default;

std::string FleetWorld::robot_name(int robot) { return fmt::format("r o.b*{}", robot); }
std::string FleetWorld::type_of(std::size_t command) const {
  return options_.has_unique_types ? fmt::format("c{}", command) : "cmd";
}
int FleetWorld::robot_number(const std::string& name) { return std::stoi(name.substr(6)); }
std::string FleetWorld::gateway_name(int gateway) { return fmt::format("gw-{}", gateway); }
Ownership& FleetWorld::ownership(int gateway) {
  return *nodes_.at(std::size_t(gateway))->ownership;
}
Now FleetWorld::clock_of(const Node& node) const {
  const auto since = now_ + node.clock_offset;
  return {TimePoint(since), WallTime(since)};
}

milliseconds FleetWorld::random_delay() {
  return between(options_.least_delay, options_.most_delay);
}

// --- robots ------------------------------------------------------------------------------------

void FleetWorld::roam(int robot, int gateway) {
  Robot& who = robots_[static_cast<std::size_t>(robot)];
  who.at = gateway;
  story_.push_back(fmt::format("{} {} roams to {}", now_.count(), robot, gateway));
  speak(robot, ++who.visit);
}

void FleetWorld::silence(int robot) { robots_[static_cast<std::size_t>(robot)].is_alive = false; }

void FleetWorld::speak(int robot, std::uint64_t visit) {
  Robot& who = robots_[static_cast<std::size_t>(robot)];
  if (!who.is_alive || who.visit != visit) return;
  who.last_said = now_;
  const std::string name = robot_name(robot);
  to_gateway(who.at, [this, name](Node& node) {
    const bool is_new = node.sessions.insert_or_assign(name, now_).second;
    if (robots_[static_cast<std::size_t>(robot_number(name))].visit == 1)
      node.kept[name] = to_bytes(name);
    node.ownership->on_heard(name, clock_of(node));
    const bool is_due = robots_[static_cast<std::size_t>(robot_number(name))].said++ % 20 == 0;
    if ((is_new || is_due) && node.is_link_up &&
        node.ownership->may_act_for(name, clock_of(node).mono))
      publish(-1, {"p/gateway/" + node.name + "/robots/" + name, to_bytes("online"),
                   Qos::at_least_once, true});
  });
  at(now_ + pace, [this, robot, visit] { speak(robot, visit); });
}

void FleetWorld::command(int robot) {
  const auto id = commands_.size();
  Command& command = commands_.emplace_back();
  command.robot = robot;
  command.said = now_;
  publish(-1, {"p/server/" + robot_name(robot) + "/" + type_of(id), to_bytes(std::to_string(id)),
               Qos::at_least_once, false});
}

// --- gateways ------------------------------------------------------------------------------------

void FleetWorld::start(int gateway) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  node.is_running = true;
  node.process = random_();
  Settings settings{options_.enabled, (node.process << 16U) | 0xabcdU, remembers_others_[gateway]};
  node.ownership = std::make_unique<Ownership>(FleetTopics("p", node.name), settings, [&node] {
    std::vector<LocalRobot> local;
    for (const auto& [robot, heard] : node.sessions) local.push_back({robot, true});
    return local;
  });
  restore_link(gateway);
  supervise(gateway);
  at(now_ + leftovers_after, [this, gateway, process = node.process] {
    to_gateway(gateway, [this, gateway, process](Node& each) {
      if (each.process == process) withdraw_leftovers(gateway);
    });
  });
}

/// As LeftoverRobots: what an earlier life has left as online.
void FleetWorld::withdraw_leftovers(int gateway) {
  const Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  for (int i = 0; i < robots(); ++i) {
    const std::string topic = "p/gateway/" + node.name + "/robots/" + robot_name(i);
    if (retained_.contains(topic) && !node.ownership->speaks_for(robot_name(i), clock_of(node)))
      publish(-1, {topic, {}, Qos::at_least_once, true});
  }
}

void FleetWorld::kill(int gateway) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  story_.push_back(fmt::format("{} {} dies", now_.count(), gateway));
  node.is_running = node.is_paused = node.is_link_up = false;
  node.waiting.clear();
  node.filters.clear();
  node.standing.clear();
  publish(-1, {"p/gateway/" + node.name + "/state", to_bytes(R"({"state":"offline"})"),
               Qos::at_least_once, true});
}

void FleetWorld::pause(int gateway) {
  story_.push_back(fmt::format("{} {} stops", now_.count(), gateway));
  nodes_[static_cast<std::size_t>(gateway)]->is_paused = true;
}

void FleetWorld::resume(int gateway) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  story_.push_back(fmt::format("{} {} goes on", now_.count(), gateway));
  node.is_paused = false;
  for (auto& act : std::exchange(node.waiting, {})) act();
  arm(gateway);
}

void FleetWorld::cut_link(int gateway) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  if (!node.is_running) return;
  story_.push_back(fmt::format("{} {} is cut off", now_.count(), gateway));
  node.is_link_up = false;
  ++node.connection;
  input(gateway, [&](Node& each) { each.ownership->on_broker_link(false, clock_of(each)); });
}

void FleetWorld::restore_link(int gateway) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  if (!node.is_running || node.is_link_up) return;
  node.is_link_up = true;
  story_.push_back(fmt::format("{} {} is connected", now_.count(), gateway));
  const bool is_session_kept = !node.standing.empty() && options_.keeps_sessions;
  if (!is_session_kept) node.standing.clear();
  const auto wanted = node.filters;  // of the connection before; the core asks for them again
  node.subscribed = now_;
  for (const std::string& filter : wanted) subscribe(gateway, filter);
  for (const auto& [robot, heard] : node.sessions)  // as the core does
    if (node.ownership->may_announce(robot, Presence::online, false, clock_of(node).mono))
      publish(gateway, {"p/gateway/" + node.name + "/robots/" + robot, to_bytes("online"),
                        Qos::at_least_once, true});
  input(gateway,
        [&](Node& each) { each.ownership->on_broker_link(true, clock_of(each), is_session_kept); });
  for (const BrokerMessage& message : std::exchange(node.kept_by_broker, {}))
    deliver(-1, gateway, message);
  for (int from = 0; from < gateways(); ++from) {  // all of one session keeps its order
    milliseconds& last = last_delivery_[{from, gateway}];
    last = std::max(last, last_delivery_[{-1, gateway}]);
  }
  say_online(gateway);
  for (const BrokerMessage& message : std::exchange(node.stored, {})) publish(gateway, message);
}

void FleetWorld::set_side(int gateway, int side) {
  nodes_[static_cast<std::size_t>(gateway)]->side = side;
}

/// A gateway's own watch over its sessions.
void FleetWorld::supervise(int gateway) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  const std::uint64_t process = node.process;
  at(now_ + milliseconds(200), [this, gateway, process] {
    Node& each = *nodes_[static_cast<std::size_t>(gateway)];
    if (!each.is_running || each.process != process) return;
    to_gateway(gateway, [this](Node& awake) {
      std::vector<std::string> lost;
      for (const auto& [robot, heard] : awake.sessions)
        if (now_ - heard > keep_alive) lost.push_back(robot);
      for (const std::string& robot : lost) {
        awake.sessions.erase(robot);
        publish(-1, {"p/gateway/" + awake.name + "/robots/" + robot, {}, Qos::at_least_once, true});
        awake.ownership->on_will(will_of(robot), clock_of(awake));
      }
    });
    supervise(gateway);
  });
}

void FleetWorld::to_gateway(int gateway, std::function<void(Node&)> change) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  if (!node.is_running) return;
  if (node.is_paused)
    return node.waiting.push_back([this, gateway, change] { input(gateway, change); });
  input(gateway, change);
}

void FleetWorld::input(int gateway, const std::function<void(Node&)>& change) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  if (!node.is_running) return;
  change(node);
  drain(gateway);
  arm(gateway);
}

void FleetWorld::drain(int gateway) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  while (auto action = node.ownership->next_action())
    std::visit([&](auto& what) { perform(gateway, what); }, *action);
}

void FleetWorld::arm(int gateway) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  if (!node.is_running || node.is_paused) return;
  const auto deadline = node.ownership->deadline();
  if (!deadline) return;
  const auto since = std::chrono::ceil<milliseconds>(deadline->time_since_epoch());
  const milliseconds due = std::max(now_, since - node.clock_offset);
  if (node.armed && *node.armed <= due && *node.armed >= now_) return;
  node.armed = due;
  const std::uint64_t process = node.process;
  at(due, [this, gateway, process, due] {
    Node& each = *nodes_[static_cast<std::size_t>(gateway)];
    if (each.process != process || each.armed != due) return;
    each.armed.reset();
    to_gateway(gateway, [this](Node& awake) { awake.ownership->on_deadline(clock_of(awake)); });
  });
}

// --- what gateways do --------------------------------------------------------------------------

void FleetWorld::perform(int gateway, PublishNow& action) { publish(gateway, action.message); }

void FleetWorld::perform(int gateway, SubscribeFleet& action) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  node.filters.insert(action.filter);
  if (node.is_link_up) subscribe(gateway, action.filter);
}

void FleetWorld::perform(int gateway, UnsubscribeFleet& action) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  node.filters.erase(action.filter);
  node.standing.erase(action.filter);
}

void FleetWorld::perform(int gateway, TakeOverRobot& action) {
  story_.push_back(fmt::format("{} {} takes over {} (dead: '{}')", now_.count(), gateway,
                               action.robot, action.dead_owner));
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  Bytes& kept = node.kept[action.robot];
  if (kept.empty()) kept = action.session;
  const auto presence = [&](const std::string& name, const char* what) {
    publish(-1, {"p/gateway/" + name + "/robots/" + action.robot, to_bytes(what),
                 Qos::at_least_once, true});
  };
  // As the core does: a robot that another gateway has asked about may be elsewhere by now.
  if (node.sessions.contains(action.robot)) presence(gateway_name(gateway), "online");
  if (!action.dead_owner.empty()) presence(action.dead_owner, "");
}

void FleetWorld::perform(int gateway, GiveUpRobot& action) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  story_.push_back(fmt::format("{} {} gives up {} to {}", now_.count(), gateway, action.robot,
                               action.to.gateway));
  node.sessions.erase(action.robot);
  publish(-1, {"p/gateway/" + node.name + "/robots/" + action.robot, {}, Qos::at_least_once, true});
  Bytes session = std::move(node.kept[action.robot]);
  node.kept.erase(action.robot);
  if (action.is_awaited)
    node.ownership->on_given_up(action.robot, action.to, std::move(session), clock_of(node));
}

void FleetWorld::perform(int gateway, CarryOut& action) {
  const std::string id(as_text(action.command.payload));
  Command& command = commands_[static_cast<std::size_t>(std::stoi(id))];
  const Robot& robot = robots_[static_cast<std::size_t>(command.robot)];
  command.came = now_ - action.command.waited;
  if (++command.on_air > 1) {
    ++seen_.doubled_commands;
    story_.push_back(fmt::format("{} DOUBLED {} at {}", now_.count(), id, gateway));
  }
  const bool is_here = robot.at == gateway && robot.is_alive;
  const std::uint64_t process = nodes_[static_cast<std::size_t>(gateway)]->process;
  at(now_ + (is_here ? on_air : timeout), [this, gateway, process, id] {
    to_gateway(gateway, [this, gateway, process, id](Node& node) {
      if (node.process == process)
        end_command(gateway, robot_name(commands_[std::stoul(id)].robot), id, "carried out",
                    now_ - commands_[std::stoul(id)].came);
    });
  });
}

void FleetWorld::perform(int gateway, EndCommand& action) {
  // Which of equal commands it is does not matter to users: the oldest heard one without any.
  const int robot = robot_number(action.robot);
  for (std::size_t i = 0; i < commands_.size(); ++i) {
    const Command& command = commands_[i];
    if (command.robot != robot || !command.was_heard || action.type != type_of(i)) continue;
    if (!options_.has_unique_types && command.outcomes + command.promised > 0) continue;
    ++commands_[i].promised;
    return end_command(gateway, action.robot, std::to_string(i), action.why, action.after);
  }
  ++seen_.doubled_outcomes;
  story_.push_back(fmt::format("{} OUTCOME TOO MANY for {} at {}: {}", now_.count(), action.robot,
                               gateway, action.why));
}

void FleetWorld::end_command(int gateway, const std::string& robot, const std::string& id,
                             const std::string& why, Duration after) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  const nlohmann::json outcome{{"type", type_of(std::stoul(id))},
                               {"id", id},
                               {"why", why},
                               {"after_ms", static_cast<std::uint64_t>(after.count() / 1'000'000)}};
  node.ownership->on_own_outcome({"p/gateway/" + node.name + "/commands/" + robot,
                                  to_bytes(outcome.dump()), Qos::at_least_once, false},
                                 after, clock_of(node));
}

void FleetWorld::perform(int gateway, PublishOutcomeNow& action) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  if (!node.is_link_up) return;
  publish(gateway, action.message);
  at(now_ + random_delay(),
     [this, gateway, id = action.id, connection = node.connection, process = node.process] {
       to_gateway(gateway, [id, connection, process](Node& each) {
         if (each.process == process && each.connection == connection)
           each.ownership->on_outcome_acknowledged(id);
       });
     });
}

/// The broker has it.
void FleetWorld::count_outcome(int gateway, const BrokerMessage& message) {
  const std::string id = nlohmann::json::parse(message.payload)["id"];
  Command& command = commands_[std::stoul(id)];
  const std::string outcome = fmt::format("{} {}", gateway, as_text(message.payload));
  if (command.outcome == outcome) {
    ++seen_.repeated_outcomes;
    return;
  }
  command.outcome = outcome;
  if (++command.outcomes < 2) return;
  ++seen_.doubled_outcomes;
  story_.push_back(fmt::format("{} SECOND OUTCOME of {} at {}", now_.count(), id, gateway));
}

void FleetWorld::publish_stored(int gateway, const BrokerMessage& message) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  if (!node.is_link_up) return node.stored.push_back(message);
  publish(gateway, message);
}

void FleetWorld::perform(int gateway, PublishWill& action) {
  Robot& robot = robots_[static_cast<std::size_t>(robot_number(action.will.robot))];
  ++robot.wills;
  const Node& place = *nodes_[static_cast<std::size_t>(robot.at)];
  const bool is_heard = place.is_running && !place.is_paused && place.is_link_up;
  if (is_trusted && robot.is_alive && is_heard && now_ - robot.last_said < keep_alive) {
    ++seen_.false_wills;
    story_.push_back(
        fmt::format("{} FALSE WILL of {} at {}", now_.count(), action.will.robot, gateway));
  }
}

void FleetWorld::perform(int gateway, Notice& action) {
  story_.push_back(fmt::format("{} {} says: {}", now_.count(), gateway, action.text));
}

// --- the broker ----------------------------------------------------------------------------------

void FleetWorld::forge(const std::string& topic, const std::string& payload) {
  publish(-1, {topic, to_bytes(payload), Qos::at_least_once, false});
}

void FleetWorld::publish(int from, const BrokerMessage& message) {
  if (from >= 0) {
    if (!nodes_[static_cast<std::size_t>(from)]->is_link_up) return;
    if (is_fleet_forbidden_ && message.topic.starts_with("p/fleet/")) return;
    ++published_;
    if (message.topic.find("/commands/") != std::string::npos) count_outcome(from, message);
    const auto json =
        nlohmann::json::parse(message.payload.begin(), message.payload.end(), nullptr, false);
    ++kinds_[json.is_object() && json.contains("k") ? json["k"].get<std::string>() : "other"];
    if (json.is_object() && json.contains("k") && json["k"] == "taken")
      story_.push_back(fmt::format("{} {} {} {}, {} ms old", now_.count(), from,
                                   json.contains("refused") ? "refuses" : "takes",
                                   json["type"].get<std::string>(), json["age"].get<int>()));
  }
  if (message.retain) retained_[message.topic] = message;
  if (message.retain && message.payload.empty()) retained_.erase(message.topic);
  for (int to = 0; to < gateways(); ++to) {
    const Node& node = *nodes_[static_cast<std::size_t>(to)];
    for (const std::string& filter : node.standing) {
      if (!filter_matches(filter, message.topic)) continue;
      const auto side = from < 0 ? node.side : nodes_[static_cast<std::size_t>(from)]->side;
      if (side == node.side) {
        BrokerMessage live = message;
        live.retain = false;
        deliver(from, to, live);
      }
    }
  }
}

void FleetWorld::subscribe(int gateway, const std::string& filter) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  if (options_.subscribing == milliseconds(0)) return stand(gateway, filter);
  const int times = chance(0.1) ? 10 : 1;
  node.subscribed = std::max(now_, node.subscribed) + options_.subscribing * times;
  at(node.subscribed,
     [this, gateway, filter, process = node.process, connection = node.connection] {
       const Node& each = *nodes_[static_cast<std::size_t>(gateway)];
       const bool is_wanted = each.is_link_up && each.filters.contains(filter);
       if (is_wanted && each.process == process && each.connection == connection)
         stand(gateway, filter);
     });
}

/// The broker knows of the subscription, sends what it retains, and answers.
void FleetWorld::stand(int gateway, const std::string& filter) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  node.standing.insert(filter);
  milliseconds& last = last_delivery_[{-1, gateway}];
  last = std::max(last, now_ + random_delay());
  at(last, [this, gateway, process = node.process, connection = node.connection, filter] {
    to_gateway(gateway, [this, process, connection, filter](Node& each) {
      if (each.process == process && each.connection == connection && each.is_link_up)
        each.ownership->on_subscribe_result(filter, SubscribeAnswer::granted, clock_of(each));
    });
  });
  for (const auto& [topic, message] : retained_)
    if (filter_matches(filter, topic)) deliver(-1, gateway, message);
}

void FleetWorld::deliver(int from, int to, const BrokerMessage& message) {
  if (message.qos == Qos::at_most_once && chance(options_.lost)) return;
  milliseconds& last = last_delivery_[{from, to}];
  last = std::max(last, now_ + random_delay());
  const Node& node = *nodes_[std::size_t(to)];
  const auto come = [this, to, life = node.process,
                     link = node.connection](const BrokerMessage& copy) {
    Node& each = *nodes_[static_cast<std::size_t>(to)];
    if (each.process != life) return;
    const bool is_lost = copy.qos == Qos::at_most_once || !options_.keeps_sessions;
    if (each.connection == link && each.is_link_up) {
      to_gateway(to, [this, to, copy, life, link](Node& awake) {
        if (awake.process == life && awake.connection == link) arrive(to, copy);
      });
    } else if (each.is_link_up && !is_lost) {
      deliver(-1, to, copy);  // behind what the broker has kept
    } else if (!is_lost) {
      each.kept_by_broker.push_back(copy);
    }
  };
  at(last, [come, message] { come(message); });
  const bool is_command = message.topic.starts_with("p/server/");  // equal ones are two commands
  if (message.qos == Qos::at_most_once || is_command || !chance(options_.doubled)) return;
  BrokerMessage again = message;
  again.is_dup = true;
  at(last + random_delay(), [come, again] { come(again); });
}

void FleetWorld::arrive(int gateway, const BrokerMessage& message) {
  Node& node = *nodes_[static_cast<std::size_t>(gateway)];
  if (node.ownership->on_broker_message(message, clock_of(node))) return;
  const TopicScheme scheme("p", node.name);
  const auto target = scheme.parse_command_topic(message.topic);
  if (!target) return;
  const std::size_t id = std::stoul(std::string(as_text(message.payload)));
  if (id < commands_.size()) commands_[id].was_heard = true;
  node.ownership->on_command(message, std::string(target->robot), std::string(target->type),
                             clock_of(node));
}

// --- judging -------------------------------------------------------------------------------------

std::vector<int> FleetWorld::actors(int robot) const {
  std::vector<int> found;
  for (int i = 0; i < gateways(); ++i) {
    const Node& node = *nodes_[static_cast<std::size_t>(i)];
    if (node.is_running && !node.is_paused &&
        node.ownership->may_act_for(robot_name(robot), clock_of(node).mono))
      found.push_back(i);
  }
  return found;
}

void FleetWorld::look() {
  for (int robot = 0; robot < robots(); ++robot) {
    const auto found = actors(robot);
    if (found.size() < 2 || !is_trusted) continue;
    ++seen_.two_owners;
    story_.push_back(
        fmt::format("{} TWO OWNERS of {}: {} {}", now_.count(), robot, found[0], found[1]));
  }
  at(now_ + look_pace, [this] { look(); });
}

std::vector<int> FleetWorld::online_at(int robot) const {
  std::vector<int> found;
  for (int i = 0; i < gateways(); ++i)
    if (retained_.contains("p/gateway/" + gateway_name(i) + "/robots/" + robot_name(robot)))
      found.push_back(i);
  return found;
}

void FleetWorld::look_at_presence() {
  for (int i = 0; i < robots(); ++i) {
    Robot& robot = robots_[static_cast<std::size_t>(i)];
    const auto online = online_at(i);
    if (online.size() < 2 || !is_trusted) {
      robot.two_online.reset();
    } else if (!robot.two_online) {
      robot.two_online = now_;
    } else if (now_ - *robot.two_online == longest_two_online + presence_pace) {
      ++seen_.two_online;
      story_.push_back(
          fmt::format("{} TWO ONLINE of {}: {} {}", now_.count(), i, online[0], online[1]));
    }
  }
  at(now_ + presence_pace, [this] { look_at_presence(); });
}

bool FleetWorld::has_session(int robot) const {
  const Node& node = *nodes_[static_cast<std::size_t>(robots_[static_cast<std::size_t>(robot)].at)];
  const auto kept = node.kept.find(robot_name(robot));
  return kept != node.kept.end() && !kept->second.empty();
}

FleetWorld::Judgement FleetWorld::judge() const {
  Judgement all = seen_;
  for (const Command& command : commands_)
    if (command.outcomes == 0) ++(command.was_heard ? all.missing_outcomes : all.unheard_commands);
  for (int i = 0; i < robots(); ++i) {
    const Robot& robot = robots_[static_cast<std::size_t>(i)];
    if (!robot.is_alive) {
      if (robot.wills == 0) ++all.missing_wills;
      continue;
    }
    if (actors(i) != std::vector<int>{robot.at}) ++all.without_owner;
    if (!has_session(i)) ++all.lost_sessions;
    if (online_at(i) != std::vector<int>{robot.at}) ++all.strange_presence;
  }
  return all;
}

std::string FleetWorld::describe() const {
  std::string text;
  for (const std::string& line : story_) text += line + '\n';
  for (std::size_t i = 0; i < commands_.size(); ++i)
    if (commands_[i].outcomes != 1)
      text += fmt::format("command {} to {} at {}: {} outcomes, {} on air\n", i, commands_[i].robot,
                          commands_[i].said.count(), commands_[i].outcomes, commands_[i].on_air);
  return text;
}

}  // namespace slamgw::fleet::test

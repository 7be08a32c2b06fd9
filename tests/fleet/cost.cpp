// SPDX-License-Identifier: Apache-2.0
// What a fleet costs as it grows, in virtual time: robots roam, the broker falls apart and heals,
// all gateways start together, one comes to the others, one dies. Prints one row of the tables in
// docs/fleet.md:
//
//   fleet_cost GATEWAYS ROBOTS [ROAMS-A-SECOND [SECONDS]]
//
// Real machines of Ownership on a broker that takes 1 to 40 ms. Each gateway knows each robot, as
// in life: ROBOTS x GATEWAYS x 70 octets of memory. Exit status 1: a robot has not one owner and
// one retained `online`, where it is, at the end, or a roam costs more messages than promised.
#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <queue>
#include <random>
#include <set>
#include <vector>

#include "daemon/fleet/ownership.hpp"

namespace slamgw::fleet {
namespace {

using namespace std::chrono_literals;
using std::chrono::milliseconds;

/// Of gateways to each other and of retained presence, on average.
constexpr double most_messages_a_roam = 4;

struct Load {
  int gateways = 10;  ///< 2 at least
  int robots = 1000;
  int roams_a_second = 10;
  int seconds = 30;  ///< of roaming, and of the time apart
};

/// Times of which the worst matter.
std::string quantiles(std::vector<milliseconds> times) {
  if (times.empty()) return "none";
  std::ranges::sort(times);
  const auto at = [&](double part) {
    const auto last = static_cast<double>(times.size() - 1);
    return std::chrono::duration<double>(times[static_cast<std::size_t>(part * last)]).count();
  };
  return fmt::format("{:.3f} s (p50) {:.3f} s (p99) {:.3f} s (most) of {}", at(0.5), at(0.99),
                     at(1), times.size());
}

class Fleet {
 public:
  explicit Fleet(Load load) : load_(load), robots_(static_cast<std::size_t>(load.robots)) {
    nodes_.resize(static_cast<std::size_t>(load.gateways) + 1);  // the last one is the newcomer
    for (int i = 0; i < load.robots; ++i) robots_[i].at = i % load.gateways;
    // One after the other, so that their beats are spread evenly, as in life.
    for (int i = 0; i < load.gateways; ++i, run(apart)) start(i);
  }

  void run(milliseconds span) {
    const milliseconds end = now_ + span;
    while (!events_.empty() && events_.top().at <= end) {
      const Event event = events_.top();
      events_.pop();
      now_ = event.at;
      if (event.message) {
        deliver(*event.message);
      } else {
        input(event.gateway, [&](Ownership& it) { it.on_deadline(clock()); });
      }
    }
    now_ = end;
  }
  /// Robots move to another gateway each, at an even pace for `span`; none twice within 80 ms.
  void roam_for(milliseconds span) {
    const auto pause = milliseconds(1000 / load_.roams_a_second);
    for (const milliseconds end = now_ + span; now_ < end; run(pause)) {
      auto robot = static_cast<int>(pick(load_.robots));
      while (now_ - robots_[robot].moved < settling) robot = (robot + 1) % load_.robots;
      const auto further = static_cast<int>(1 + pick(load_.gateways - 1));
      move(robot, (robots_[robot].at + further) % load_.gateways);
      ++roams_;
    }
  }
  void split() {
    for (std::size_t i = 0; i < nodes_.size(); i += 3) nodes_[i].side = 1;
  }
  void heal() {
    for (Node& node : nodes_) node.side = 0;
  }
  /// All gateways lose the broker, and with it what was on its way, and are back at one moment.
  void restart_broker(milliseconds away) {
    ++broker_life_;
    for (int i = 0; i < load_.gateways; ++i)
      input(i, [&](Ownership& it) { it.on_broker_link(false, clock()); });
    run(away);
    for (int i = 0; i < load_.gateways; ++i) connect(i);
  }
  /// One more gateway, without robots. Leaves when it knows where each robot is.
  milliseconds welcome() {
    constexpr milliseconds step{10};
    constexpr milliseconds most{120'000};
    const milliseconds begin = now_;
    start(load_.gateways);
    const Ownership& newcomer = *nodes_.back().ownership;
    while (now_ - begin < most && (newcomer.phase() != Ownership::Phase::member ||
                                   newcomer.claims().size() < robots_.size()))
      run(step);
    return now_ - begin;
  }
  std::string newcomer_traffic() const {
    const Node& node = nodes_.back();
    return fmt::format("it got {} messages, of these {} tables, {:.1f} kB", node.heard,
                       node.tables_heard, static_cast<double>(node.octets) / 1000);
  }
  /// The first gateway falls silent. Its robots are heard by others at once.
  void kill() {
    nodes_.front().ownership.reset();
    for (int i = 0; i < load_.robots; ++i) {
      std::erase(robots_[i].owners, 0);
      if (robots_[i].at == 0) move(i, static_cast<int>(1 + pick(load_.gateways - 1)));
    }
  }
  /// Robots that are not served by the gateway that they are at, and by it alone.
  int unsettled() const {
    return static_cast<int>(
        std::ranges::count_if(robots_, [&](const Robot& each) { return !is_settled(each); }));
  }
  /// As unsettled(), asking each gateway about each robot.
  int unsettled_by_asking() const {
    std::vector<int> actors(robots_.size());
    for (std::size_t i = 0; i < nodes_.size(); ++i) {
      for (std::size_t robot = 0; nodes_[i].ownership && robot < robots_.size(); ++robot) {
        if (nodes_[i].ownership->may_act_for(name_of(static_cast<int>(robot)), clock().mono))
          actors[robot] += robots_[robot].at == static_cast<int>(i) ? 1 : 100;
      }
    }
    return static_cast<int>(std::ranges::count_if(actors, [](int each) { return each != 1; }));
  }
  /// Robots without one retained `online`, where they are.
  int misplaced() const {
    std::vector<int> places(robots_.size());
    for (const auto& [gateway, robot] : retained_)
      places[robot] += robots_[robot].at == gateway ? 1 : 100;
    return static_cast<int>(std::ranges::count_if(places, [](int each) { return each != 1; }));
  }
  /// Until each robot has one owner, where it is; each is heard once a second. Leaves the times.
  std::vector<milliseconds> settle(milliseconds most) {
    constexpr milliseconds step{100};
    constexpr int steps_a_second = 10;
    const milliseconds begin = now_;
    std::vector<milliseconds> settled(robots_.size(), milliseconds(-1));
    std::vector<bool> was_unsettled(robots_.size());
    for (int turn = 0; now_ - begin < most; ++turn) {
      int left = 0;
      for (std::size_t i = 0; i < robots_.size(); ++i) {
        if (is_settled(robots_[i])) {
          if (settled[i] < milliseconds(0)) settled[i] = now_ - begin;
          continue;
        }
        was_unsettled[i] = true;
        settled[i] = milliseconds(-1);
        ++left;
      }
      if (left == 0 && now_ - begin >= quiet) break;
      for (int i = turn % steps_a_second; i < load_.robots; i += steps_a_second)
        input(robots_[i].at, [&](Ownership& it) { it.on_heard(name_of(i), clock()); });
      run(step);
    }
    std::vector<milliseconds> times;
    for (std::size_t i = 0; i < robots_.size(); ++i)
      if (was_unsettled[i]) times.push_back(settled[i] < milliseconds(0) ? most : settled[i]);
    return times;
  }
  void begin_to_count() {
    published_ = beats_ = tables_ = presence_ = 0;
    roams_ = 0;
    busiest_second_ = 0;
    most_retained_ = retained_.size();
    moves_.clear();
    counted_from_ = now_;
    for (Node& node : nodes_)
      node.heard = node.tables_heard = node.octets = node.heard_this_second = 0;
  }
  std::string traffic() const {
    const double seconds = std::chrono::duration<double>(now_ - counted_from_).count();
    std::uint64_t heard = 0;
    std::uint64_t octets = 0;
    for (const Node& node : nodes_) {
      heard += node.heard;
      octets += node.octets;
    }
    return fmt::format(
        "{:.2f} beats a second each, a gateway hears {:.0f} messages ({:.1f} kB) a second on "
        "average, the busiest {} in its busiest second; {} retained entries of robots at most",
        static_cast<double>(beats_) / seconds / load_.gateways,
        static_cast<double>(heard) / seconds / load_.gateways,
        static_cast<double>(octets) / seconds / load_.gateways / 1000, busiest_second_,
        most_retained_);
  }
  /// Claims, releases and what else is not sent for other reasons.
  double messages_a_roam() const {
    return static_cast<double>(published_ - beats_ - tables_) / std::max(1, roams_);
  }
  /// Tables, and questions for them: at most one each 2 s from one gateway to another.
  std::uint64_t tables() const { return tables_; }
  double presence_a_roam() const { return static_cast<double>(presence_) / std::max(1, roams_); }
  const std::vector<milliseconds>& moves() const { return moves_; }
  milliseconds now() const { return now_; }

 private:
  struct Message {
    std::string topic;
    FleetMessage message;
    std::size_t octets = 0;
    int from = 0;
    int to = -1;  ///< -1: all
    int side = 0;
    int broker_life = 0;
  };
  /// Smaller than those of VirtualTime: millions wait, and many share one message.
  struct Event {
    milliseconds at{};
    std::uint64_t order = 0;
    int gateway = 0;
    std::shared_ptr<Message> message;  ///< none: the gateway's deadline
    bool operator<(const Event& other) const {
      return std::pair(other.at, other.order) < std::pair(at, order);
    }
  };
  struct Node {
    std::unique_ptr<Ownership> ownership;
    milliseconds armed{-1};
    milliseconds last_sent{0};  ///< one writer's messages keep their order
    int side = 0;
    std::uint64_t heard = 0;
    std::uint64_t tables_heard = 0;
    std::uint64_t octets = 0;
    std::uint64_t heard_this_second = 0;
    std::chrono::seconds second{0};
  };
  struct Robot {
    int at = 0;
    milliseconds moved{-1000};
    bool is_moving = false;
    std::vector<int> owners{};  ///< gateways that have taken it over and not given it up
  };
  static constexpr milliseconds apart{5};
  static constexpr milliseconds settling{80};  ///< the way to the broker and back, twice
  /// Settled means that nothing happens for so long: a beat of everybody, and what it causes.
  static constexpr std::chrono::seconds quiet{20};

  static std::string name_of(int robot) { return fmt::format("robot-{}", robot); }
  static std::string gateway_of(int gateway) { return fmt::format("gw-{}", gateway); }
  Now clock() const { return {TimePoint(now_ + 1h), WallTime(now_ + 1h)}; }
  std::size_t pick(int count) {
    return std::uniform_int_distribution<std::size_t>(0,
                                                      static_cast<std::size_t>(count) - 1)(random_);
  }

  void start(int gateway) {
    nodes_[gateway].ownership = std::make_unique<Ownership>(
        FleetTopics("p", gateway_of(gateway)),
        Settings{Enabled::yes, static_cast<Life>(gateway + 1) << 16U}, [this, gateway] {
          std::vector<LocalRobot> local;
          for (int i = 0; i < load_.robots; ++i)
            if (robots_[i].at == gateway) local.push_back({name_of(i), true});
          return local;
        });
    connect(gateway);
  }

  /// The core asks for all subscriptions again at each connection.
  void connect(int gateway) {
    input(gateway, [&](Ownership& it) { it.on_broker_link(true, clock()); });
    const FleetTopics topics("p", gateway_of(gateway));
    for (const std::string& filter :
         {topics.all_filter(), topics.own_filter(), topics.command_filter(),
          topics.outcome_filter(), topics.state_filter()}) {
      input(gateway, [&](Ownership& it) {
        it.on_subscribe_result(filter, SubscribeAnswer::granted, clock());
      });
    }
  }

  void move(int number, int place) {
    robots_[number].at = place;
    robots_[number].moved = now_;
    robots_[number].is_moving = true;
    input(place, [&](Ownership& it) { it.on_heard(name_of(number), clock()); });
  }

  template <typename Change>
  void input(int gateway, Change change) {
    Node& node = nodes_[gateway];
    if (!node.ownership) return;
    change(*node.ownership);
    while (auto action = node.ownership->next_action()) {
      if (auto* said = std::get_if<PublishNow>(&*action)) publish(gateway, said->message);
      if (auto* asked = std::get_if<SubscribeFleet>(&*action))
        node.ownership->on_subscribe_result(asked->filter, SubscribeAnswer::granted, clock());
      if (auto* taken = std::get_if<TakeOverRobot>(&*action))
        count_owner(gateway, taken->robot, true);
      tell_presence(gateway, *action);
      const auto* given = std::get_if<GiveUpRobot>(&*action);
      if (given) count_owner(gateway, given->robot, false);
      if (given && given->is_awaited)
        node.ownership->on_given_up(given->robot, given->to, {}, clock());
    }
    const auto deadline = node.ownership->deadline();
    if (!deadline) return;
    const auto due = std::max(
        now_, std::chrono::ceil<milliseconds>(deadline->time_since_epoch()) - milliseconds(1h));
    if (node.armed >= now_ && node.armed <= due && node.armed != milliseconds(-1)) return;
    node.armed = due;
    events_.push({due, ++order_, gateway, nullptr});
  }

  bool is_settled(const Robot& robot) const {
    if (robot.owners.size() != 1 || robot.owners.front() != robot.at) return false;
    const auto number = static_cast<int>(&robot - robots_.data());
    return nodes_[robot.at].ownership->may_act_for(name_of(number), clock().mono);
  }
  void count_owner(int gateway, const std::string& name, bool is_owner) {
    Robot& robot = robots_[std::stoul(name.substr(6))];
    std::erase(robot.owners, gateway);
    if (is_owner) robot.owners.push_back(gateway);
    if (robot.is_moving && is_settled(robot)) {
      moves_.push_back(now_ - robot.moved);
      robot.is_moving = false;
    }
  }

  /// What a gateway retains at the broker for these actions (FleetMember, Gateway).
  void tell_presence(int gateway, const OwnershipAction& action) {
    if (const auto* taken = std::get_if<TakeOverRobot>(&action)) {
      const int robot = number_in(taken->robot, "robot-");
      retain(gateway, robot, true);
      if (!taken->dead_owner.empty()) retain(number_in(taken->dead_owner, "gw-"), robot, false);
    }
    if (const auto* given = std::get_if<GiveUpRobot>(&action))
      retain(gateway, number_in(given->robot, "robot-"), false);
  }
  void retain(int gateway, int robot, bool is_online) {
    ++presence_;
    if (is_online) {
      retained_.emplace(gateway, robot);
    } else {
      retained_.erase({gateway, robot});
    }
    most_retained_ = std::max(most_retained_, retained_.size());
  }
  static int number_in(const std::string& text, const std::string& after) {
    return std::stoi(text.substr(text.find(after) + after.size()));
  }

  void publish(int from, const BrokerMessage& message) {
    if (message.topic.starts_with("p/gateway/"))  // the entry of a robot at a dead gateway
      return retain(number_in(message.topic, "gw-"), number_in(message.topic, "robot-"), false);
    auto read = decode(gateway_of(from), message.payload);
    if (!read) std::abort();
    auto sent = std::make_shared<Message>();
    const bool is_to_all = message.topic.starts_with("p/fleet/all/");
    sent->to = is_to_all ? -1 : number_in(message.topic, "gw-");
    sent->octets = message.topic.size() + message.payload.size();
    ++published_;
    beats_ += std::holds_alternative<Beat>(read->body) ? 1 : 0;
    tables_ += is_about_tables(*read) ? 1 : 0;
    sent->message = std::move(*read);
    sent->from = from;
    sent->side = nodes_[from].side;
    sent->broker_life = broker_life_;
    Node& node = nodes_[from];
    node.last_sent = std::max(node.last_sent, now_ + milliseconds(1 + pick(40)));
    events_.push({node.last_sent, ++order_, 0, std::move(sent)});
  }

  static bool is_about_tables(const FleetMessage& message) {
    return std::holds_alternative<Table>(message.body) ||
           std::holds_alternative<AskTable>(message.body);
  }

  void count_heard(Node& node, const Message& message) {
    const auto second = std::chrono::floor<std::chrono::seconds>(now_);
    if (std::exchange(node.second, second) != second) node.heard_this_second = 0;
    busiest_second_ = std::max(busiest_second_, ++node.heard_this_second);
    ++node.heard;
    node.tables_heard += std::holds_alternative<Table>(message.message.body) ? 1 : 0;
    node.octets += message.octets;
  }

  void deliver(const Message& sent) {
    if (sent.broker_life != broker_life_) return;
    const auto to = [&](int gateway) {
      Node& node = nodes_[gateway];
      if (!node.ownership || node.side != sent.side) return;
      count_heard(node, sent);
      input(gateway, [&](Ownership& it) { it.on_fleet_message(sent.message, clock()); });
    };
    if (sent.to >= 0) return to(sent.to);
    for (int i = 0; i <= load_.gateways; ++i) to(i);
  }

  Load load_;
  std::mt19937 random_{1};
  milliseconds now_{0};
  std::uint64_t order_ = 0;
  std::priority_queue<Event> events_;
  std::vector<Node> nodes_;
  std::vector<Robot> robots_;
  std::uint64_t published_ = 0;
  std::uint64_t beats_ = 0;
  std::uint64_t tables_ = 0;
  std::uint64_t presence_ = 0;
  std::set<std::pair<int, int>> retained_;  // (gateway, robot): `online` at the broker
  std::size_t most_retained_ = 0;
  int roams_ = 0;
  int broker_life_ = 0;
  milliseconds counted_from_{0};
  std::uint64_t busiest_second_ = 0;
  std::vector<milliseconds> moves_;
};

double in_seconds(milliseconds time) { return std::chrono::duration<double>(time).count(); }

int run(Load load) {
  const std::chrono::seconds span(load.seconds);
  constexpr std::chrono::seconds patience{120};
  constexpr std::chrono::seconds away{20};  // longer than the lease of the largest fleet
  Fleet fleet(load);
  const auto say = [&](const std::string& what) {
    fmt::print("{:7.1f} s: {}\n", in_seconds(fleet.now()), what);
    std::fflush(stdout);
  };
  fmt::print("{} gateways, {} robots, {} roams a second\n", load.gateways, load.robots,
             load.roams_a_second);
  const double start = in_seconds(fleet.now());
  fleet.begin_to_count();
  const auto settle = [&](const std::string& what) {
    const auto settled = fleet.settle(patience);
    say(fmt::format("{}: one owner after {}; {}", what, quantiles(settled), fleet.traffic()));
  };
  settle(fmt::format("started within {} s", start));
  fleet.begin_to_count();
  fleet.roam_for(span);
  const double between = fleet.messages_a_roam();
  const double presence = fleet.presence_a_roam();
  say(
      fmt::format("roaming: one owner after {}; {:.2f} messages and {:.2f} entries a roam, and "
                  "{} tables and questions for them; {}",
                  quantiles(fleet.moves()), between, presence, fleet.tables(), fleet.traffic()));
  fleet.begin_to_count();
  fleet.split();
  fleet.roam_for(span);
  say(fmt::format("apart: {} robots without one owner where they are; {}", fleet.unsettled(),
                  fleet.traffic()));
  fleet.begin_to_count();
  fleet.heal();
  settle("whole again");
  fleet.begin_to_count();
  fleet.restart_broker(away);
  settle(fmt::format("all start together after {} s without broker", away.count()));
  fleet.begin_to_count();
  const double joined = in_seconds(fleet.welcome());
  say(fmt::format("one more gateway knows all after {:.2f} s; {}; {}", joined,
                  fleet.newcomer_traffic(), fleet.traffic()));
  fleet.begin_to_count();
  fleet.kill();
  settle("one gateway has died");
  const int left = fleet.unsettled_by_asking();
  const int misplaced = fleet.misplaced();
  say(
      fmt::format("each gateway asked about each robot: {} without one owner; {} without one "
                  "retained entry where they are",
                  left, misplaced));
  return left == 0 && misplaced == 0 && between + presence <= most_messages_a_roam ? 0 : 1;
}

}  // namespace
}  // namespace slamgw::fleet

int main(int argc, char** argv) {
  const auto number = [&](int at, int otherwise) {
    return argc > at ? std::max(1, std::atoi(argv[at])) : otherwise;
  };
  if (argc < 3) {
    fmt::print(stderr, "usage: fleet_cost GATEWAYS ROBOTS [ROAMS-A-SECOND [SECONDS]]\n");
    return 2;
  }
  return slamgw::fleet::run(
      {std::max(2, number(1, 10)), number(2, 1000), number(3, 10), number(4, 30)});
}

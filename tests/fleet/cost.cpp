// SPDX-License-Identifier: Apache-2.0
// What a fleet costs as it grows, in virtual time: robots roam, the broker falls apart and heals.
// Prints one row of the table in docs/fleet.md:
//
//   fleet_cost GATEWAYS ROBOTS [ROAMS-A-SECOND [SECONDS]]
//
// Real machines of Ownership on a broker that takes 1 to 40 ms. Each gateway knows each robot, as
// in life: ROBOTS x GATEWAYS x 150 octets of memory.
#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <memory>
#include <queue>
#include <random>

#include "daemon/fleet/ownership.hpp"

namespace slamgw::fleet {
namespace {

using namespace std::chrono_literals;
using std::chrono::milliseconds;

struct Load {
  int gateways = 10;
  int robots = 1000;
  int roams_a_second = 10;
  int seconds = 30;  ///< of roaming, and of the time apart
};

class Fleet {
 public:
  explicit Fleet(Load load) : load_(load), robots_(static_cast<std::size_t>(load.robots)) {
    for (int i = 0; i < load.robots; ++i) {
      robots_[i].at = i % load.gateways;
      nodes_.resize(static_cast<std::size_t>(load.gateways));
    }
    for (int i = 0; i < load.gateways; ++i) start(i);
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
  /// Roams at an even pace for `span`.
  void roam_for(milliseconds span) {
    const auto pause = milliseconds(1000 / load_.roams_a_second);
    for (const milliseconds end = now_ + span; now_ < end; run(pause)) {
      Robot& robot = robots_[pick(load_.robots)];
      robot.at = static_cast<int>(pick(load_.gateways));
      robot.moved = now_;
      const auto number = static_cast<int>(&robot - robots_.data());
      input(robot.at, [&](Ownership& it) { it.on_heard(name_of(number), clock()); });
      ++roams_;
    }
  }
  void split() {
    for (std::size_t i = 0; i < nodes_.size(); i += 3) nodes_[i].side = 1;
  }
  void heal() {
    for (Node& node : nodes_) node.side = 0;
  }
  /// Robots for which not exactly one gateway may act, or another than the one they are at.
  int unsettled() {
    int count = 0;
    std::vector<int> actors(robots_.size());
    for (std::size_t i = 0; i < nodes_.size(); ++i) {
      for (std::size_t robot = 0; robot < robots_.size(); ++robot) {
        if (nodes_[i].ownership->may_act_for(name_of(static_cast<int>(robot)), clock().mono))
          actors[robot] += robots_[robot].at == static_cast<int>(i) ? 1 : 100;
      }
    }
    for (const int each : actors) count += each == 1 ? 0 : 1;
    return count;
  }
  milliseconds settle(milliseconds step, milliseconds most) {
    const milliseconds begin = now_;
    while (unsettled() > 0 && now_ - begin < most) {
      for (int i = 0; i < load_.robots; ++i)
        input(robots_[i].at, [&](Ownership& it) { it.on_heard(name_of(i), clock()); });
      run(step);
    }
    return now_ - begin;
  }
  void begin_to_count() {
    published_ = beats_ = octets_ = heard_ = 0;
    roams_ = 0;
    moves_.clear();
    counted_from_ = now_;
  }
  std::string figures() {
    std::ranges::sort(moves_);
    const double seconds = std::chrono::duration<double>(now_ - counted_from_).count();
    const auto moved = [&](double part) {
      return moves_.empty()
                 ? 0
                 : moves_[static_cast<std::size_t>(part * static_cast<double>(moves_.size() - 1))];
    };
    return fmt::format(
        "{:.1f} messages a roam, {:.2f} beats a second each, heard at each gateway {:.0f} a second "
        "({:.1f} kB), a roam takes {} ms (p50), {} ms (p99), {} ms (most)",
        static_cast<double>(published_ - beats_) / std::max(1, roams_),
        static_cast<double>(beats_) / seconds / load_.gateways,
        static_cast<double>(heard_) / seconds / load_.gateways,
        static_cast<double>(octets_) / seconds / load_.gateways / 1000, moved(0.5), moved(0.99),
        moved(1));
  }

 private:
  struct Message {
    std::string topic;
    FleetMessage message;
    std::size_t octets = 0;
    int from = 0;
    int to = -1;  ///< -1: all
    int side = 0;
  };
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
  };
  struct Robot {
    int at = 0;
    milliseconds moved{-1};
  };

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
    input(gateway, [&](Ownership& it) { it.on_broker_link(true, clock()); });
  }

  template <typename Change>
  void input(int gateway, Change change) {
    Node& node = nodes_[gateway];
    change(*node.ownership);
    while (auto action = node.ownership->next_action()) {
      if (auto* said = std::get_if<PublishNow>(&*action)) publish(gateway, said->message);
      if (auto* taken = std::get_if<TakeOverRobot>(&*action)) arrived(gateway, taken->robot);
      if (auto* given = std::get_if<GiveUpRobot>(&*action); given && given->is_awaited)
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

  void arrived(int gateway, const std::string& name) {
    Robot& robot = robots_[std::stoul(name.substr(6))];
    if (robot.at == gateway && robot.moved >= milliseconds(0))
      moves_.push_back((now_ - std::exchange(robot.moved, milliseconds(-1))).count());
  }

  void publish(int from, const BrokerMessage& message) {
    auto read = decode(gateway_of(from), message.payload);
    if (!read) std::abort();
    auto sent = std::make_shared<Message>();
    const bool is_to_all = message.topic.starts_with("p/fleet/all/");
    sent->to = is_to_all ? -1 : std::stoi(message.topic.substr(message.topic.find("gw-") + 3));
    sent->octets = message.topic.size() + message.payload.size();
    ++published_;
    beats_ += std::holds_alternative<Beat>(read->body) ? 1 : 0;
    sent->message = std::move(*read);
    sent->from = from;
    sent->side = nodes_[from].side;
    Node& node = nodes_[from];
    node.last_sent = std::max(node.last_sent, now_ + milliseconds(1 + pick(40)));
    events_.push({node.last_sent, ++order_, 0, std::move(sent)});
  }

  void deliver(const Message& sent) {
    const auto to = [&](int gateway) {
      if (nodes_[gateway].side != sent.side) return;
      ++heard_;
      octets_ += sent.octets;
      input(gateway, [&](Ownership& it) { it.on_fleet_message(sent.message, clock()); });
    };
    if (sent.to >= 0) return to(sent.to);
    for (int i = 0; i < load_.gateways; ++i) to(i);
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
  std::uint64_t octets_ = 0;
  std::uint64_t heard_ = 0;
  int roams_ = 0;
  milliseconds counted_from_{0};
  std::vector<std::int64_t> moves_;
};

int run(Load load) {
  Fleet fleet(load);
  const milliseconds step = load.gateways > 100 ? 1s : 250ms;
  const auto started = fleet.settle(step, 60s);
  fleet.begin_to_count();
  fleet.roam_for(std::chrono::seconds(load.seconds));
  const std::string figures = fleet.figures();
  fleet.split();
  fleet.roam_for(std::chrono::seconds(load.seconds));
  fleet.heal();
  const auto healed = fleet.settle(step, 120s);
  const int left = fleet.unsettled();
  fmt::print(
      "{} gateways, {} robots: all served after {:.1f} s; {}; after a time apart one owner for "
      "each after {:.1f} s; {} without\n",
      load.gateways, load.robots, std::chrono::duration<double>(started).count(), figures,
      std::chrono::duration<double>(healed).count(), left);
  return left == 0 ? 0 : 1;
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
  return slamgw::fleet::run({number(1, 10), number(2, 1000), number(3, 10), number(4, 30)});
}

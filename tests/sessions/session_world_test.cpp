// SPDX-License-Identifier: Apache-2.0
// Three gateways and ten robots in random worlds: robots roam, gateways are killed, stopped and cut
// off. Whatever happens, a command is obeyed at most once and has at most one outcome.
#include <gtest/gtest.h>

#include <array>
#include <random>

#include "daemon/sessions/robot_sessions.hpp"
#include "tests/sessions/broker_model.hpp"

namespace slamgw::sessions {
namespace {

using test::BrokerModel;
using test::Hearing;

constexpr std::int64_t start_ms = 3'600'000;

/// A gateway of the world: the machine, its shell, and how it can fail.
class WorldGateway {
 public:
  using OnTaken = std::function<void(const std::string& robot, const BrokerMessage& message)>;

  WorldGateway(BrokerModel& broker, OnTaken on_taken)
      : broker_(broker), on_taken_(std::move(on_taken)) {
    begin();
  }

  void hear(const std::string& robot) {
    if (!is_running()) return;
    const std::string filter = "p/server/" + robot + "/+";
    if (!subscribed_.contains(robot)) {
      sessions_->on_heard(robot, now());
      sessions_->subscribe(robot, filter, Qos::at_least_once, false, now());
      subscribed_.insert(robot);
    } else {
      sessions_->on_heard(robot, now());
    }
    drain();
  }
  void tick() {
    if (!is_running()) return;
    sessions_->on_deadline(now());
    drain();
  }
  void cut() {
    for (const auto& [robot, link] : links_) broker_.cut(link);
  }
  void kill() {
    cut();
    begin();
  }
  void stop(bool is_stopped) {
    is_stopped_ = is_stopped;
    const auto links = links_;
    for (const auto& [robot, link] : links) broker_.stop_reading(link, is_stopped);
  }
  bool is_running() const { return !is_stopped_; }
  bool holds(const std::string& robot) const { return sessions_->is_held(robot); }

 private:
  Now now() const {
    return {TimePoint{std::chrono::milliseconds{start_ms + broker_.time_ms()}}, {}};
  }

  void begin() {
    ++life_;
    links_.clear();
    subscribed_.clear();
    sessions_ = std::make_unique<RobotSessions>(SessionNames(TopicScheme("p", "g")),
                                                [](const std::string&) { return false; });
    sessions_->on_broker_up(true, false, now());
  }
  void drain() {
    while (auto action = sessions_->next_action())
      std::visit([this](auto& what) { perform(what); }, *action);
  }
  /// `what` is called unless the gateway was killed since.
  template <class What>
  auto alive(What what) {
    return [this, life = life_, what](auto... arguments) {
      if (life != life_) return;
      what(arguments...);
      drain();
    };
  }

  void perform(OpenSession& open) {
    Hearing hearing;
    const std::string robot = open.robot;
    hearing.on_connack =
        alive([this, robot](bool is_present) { sessions_->on_attached(robot, is_present, now()); });
    hearing.on_message =
        alive([this, robot](BrokerMessage message, std::vector<std::uint32_t> ids) {
          sessions_->on_message(robot, std::move(message), ids, now());
        });
    hearing.on_suback = alive([this, robot](const std::string& filter) {
      sessions_->on_subscribed(robot, filter, true);
    });
    hearing.on_fence =
        alive([this, robot](std::uint64_t number) { sessions_->on_fence(robot, number, now()); });
    hearing.on_closed = alive([this, robot] { sessions_->on_detached(robot, now()); });
    links_[robot] = broker_.connect("p-robot-" + robot, open.is_clean, std::move(hearing));
  }
  void perform(CloseSession& close) { broker_.disconnect(links_.at(close.robot)); }
  void perform(SubscribeSession& subscribe) {
    broker_.subscribe(links_.at(subscribe.robot), subscribe.filter, subscribe.id);
  }
  void perform(UnsubscribeSession& unsubscribe) {
    broker_.unsubscribe(links_.at(unsubscribe.robot), unsubscribe.filter);
  }
  void perform(AskFence& fence) { broker_.fence(links_.at(fence.robot), fence.number); }
  void perform(SendMarker&) {}
  void perform(TakeMessage& taken) { on_taken_(taken.robot, taken.message); }
  void perform(auto&) {}

  BrokerModel& broker_;
  const OnTaken on_taken_;
  unsigned life_ = 0;
  bool is_stopped_ = false;
  std::unique_ptr<RobotSessions> sessions_;
  std::map<std::string, BrokerModel::Connection> links_;
  std::set<std::string> subscribed_;
};

struct Verdict {
  int published = 0;
  int obeyed = 0;
  int obeyed_again = 0;
};

Verdict play(unsigned seed) {
  constexpr std::size_t robots = 10;
  constexpr std::int64_t end_ms = 120'000;
  std::minstd_rand random(seed);
  const auto pick = [&](int n) { return std::uniform_int_distribution<int>(0, n - 1)(random); };
  BrokerModel broker(seed + 1);
  Verdict verdict;
  std::map<std::string, int> obeyed;
  const auto take = [&](const std::string&, const BrokerMessage& message) {
    if (obeyed[std::string(as_text(message.payload))]++ == 0)
      ++verdict.obeyed;
    else
      ++verdict.obeyed_again;
  };
  std::array<WorldGateway, 3> gateways{WorldGateway{broker, take}, WorldGateway{broker, take},
                                       WorldGateway{broker, take}};
  std::array<std::size_t, robots> place{};
  std::array<std::int64_t, 3> stopped_until{};
  for (std::int64_t time = 0; time < end_ms; time += 50) {
    broker.run_until(time);
    const bool is_quiet = time < 2000 || time > end_ms - 30'000;
    for (std::size_t i = 0; i < robots; ++i) {
      if (!is_quiet && pick(60) == 0) place[i] = static_cast<std::size_t>(pick(3));
      if (pick(4) == 0) gateways[place[i]].hear("r" + std::to_string(i));
    }
    for (std::size_t g = 0; g < 3; ++g) {
      gateways[g].tick();
      if (!gateways[g].is_running() && time >= stopped_until[g]) gateways[g].stop(false);
      if (is_quiet || !gateways[g].is_running()) continue;
      const int fate = pick(400);
      if (fate == 0) gateways[g].kill();
      if (fate == 1) gateways[g].cut();
      if (fate == 2) {
        gateways[g].stop(true);
        stopped_until[g] = time + 3000 + pick(10'000);
      }
    }
    if (time > 2000 && time < end_ms - 20'000) {
      const std::string robot = "r" + std::to_string(pick(robots));
      broker.publish({"p/server/" + robot + "/run", to_bytes(std::to_string(verdict.published++)),
                      Qos::at_least_once, false});
    }
  }
  broker.run_until(end_ms + 10'000);
  return verdict;
}

TEST(SessionWorld, NoCommandIsObeyedTwiceWhateverFails) {
  int published = 0;
  int obeyed = 0;
  for (unsigned seed = 1; seed <= 12; ++seed) {
    const Verdict verdict = play(seed);
    EXPECT_EQ(verdict.obeyed_again, 0) << "seed " << seed;
    published += verdict.published;
    obeyed += verdict.obeyed;
  }
  EXPECT_GT(published, 20'000);
  // Those that came within one round trip before a connection broke have no outcome.
  EXPECT_GT(obeyed, published * 98 / 100) << obeyed << " of " << published;
}

}  // namespace
}  // namespace slamgw::sessions

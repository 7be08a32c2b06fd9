// SPDX-License-Identifier: Apache-2.0
// Three gateways and ten robots in random worlds: robots roam, gateways are killed, stopped, cut
// off, and once all are down. In each world a command is obeyed at most once and has at most one
// outcome, and each subscriber gets its answer.
#include <gtest/gtest.h>

#include <array>
#include <random>

#include "daemon/sessions/robot_sessions.hpp"
#include "daemon/sessions/session_names.hpp"
#include "tests/sessions/broker_model.hpp"

namespace slamgw::sessions {
namespace {

using std::chrono::milliseconds;
using test::BrokerModel;
using test::Hearing;

constexpr std::int64_t start_ms = 3'600'000;
constexpr std::int64_t command_time_ms = 30'000;  ///< in which a command has its outcome
const std::string equal_payload = "equal";

/// The outcomes of the commands. Equal commands have no identity, so they are counted by robot.
struct Ledger {
  struct Fate {
    int published = 0;
    int obeyed = 0;
    int outcomes = 0;
  };
  std::map<std::string, Fate> commands;  ///< by payload
  std::map<std::string, Fate> equal;     ///< by robot
  int refused_as_stale = 0;
  int handed_on = 0;
  int without_answer = 0;  ///< subscriptions
  int answered_twice = 0;

  Fate& fate_of(const std::string& robot, const BrokerMessage& message) {
    const std::string payload(as_text(message.payload));
    return payload == equal_payload ? equal[robot] : commands[payload];
  }
};

/// The presence that gateways publish: by robot, the number of the living gateway.
using RobotPresence = std::map<std::string, std::size_t>;

std::string filter_of(const std::string& robot) {
  const bool hears_all = (robot.back() - '0') % 2 == 0;
  return "p/server/" + robot + (hears_all ? "/+" : "/run");
}

/// A gateway of the world: the machine, its shell, a mesh with a store, and how it can fail.
class WorldGateway {
 public:
  WorldGateway(std::size_t number, BrokerModel& broker, bool is_v5, Ledger& ledger,
               RobotPresence& shown)
      : number_(number), broker_(broker), is_v5_(is_v5), ledger_(ledger), shown_(shown) {
    begin();
  }

  /// Takes a robot that talks here. It connects with CleanSession 0, so its note is read first.
  void hear(const std::string& robot) {
    if (!is_running()) return;
    if (served_.insert(robot).second)
      sessions_->read_note(robot, now());
    else
      sessions_->on_heard(robot, now());
    drain();
  }
  void subscribe(const std::string& robot, const std::string& filter) {
    if (!is_running() || !served_.contains(robot)) return;
    unanswered_.emplace(std::pair(robot, filter), broker_.time_ms());
    sessions_->subscribe(robot, filter, Qos::at_least_once, false, now());
    drain();
  }
  /// `is_here`: whether the mesh reaches a robot now.
  void tick(const std::function<bool(const std::string& robot)>& is_here) {
    if (!is_running()) return;
    sessions_->on_deadline(now());
    drain();
    for (const auto& [request, since] : unanswered_)
      if (broker_.time_ms() - since > 8100) ++ledger_.without_answer;
    std::erase_if(open_, [&](const Open& open) {
      const bool is_late = age_ms(open) > command_time_ms;
      const bool is_due = broker_.time_ms() >= open.due_ms && is_here(open.robot);
      if (!is_late && !is_due) return false;
      Ledger::Fate& fate = ledger_.fate_of(open.robot, open.message);
      ++fate.outcomes;
      if (!is_late) ++fate.obeyed;
      return true;
    });
    for (const std::string& robot : std::exchange(lost_, {}))
      if (!give_up(robot)) lost_.insert(robot);
  }
  void adopt(const std::string& robot) {
    if (!is_running()) return;
    sessions_->keep(robot, now(), std::chrono::seconds{5 + number_}, now());
    drain();
  }
  void cut() {
    for (const auto& [robot, link] : links_) broker_.cut(link);
  }
  /// Kills the process. Open commands end as `timeout` when it is back; MQTT-SN sessions are on
  /// disk.
  void kill() {
    cut();
    last_alive_ = now().mono;
    for (const Open& open : std::exchange(open_, {}))
      ++ledger_.fate_of(open.robot, open.message).outcomes;
    ++life_;
    is_down_ = true;
    is_stopped_ = false;
  }
  void begin() {
    links_.clear();
    lost_.clear();
    unanswered_.clear();
    is_down_ = false;
    sessions_ = std::make_unique<RobotSessions>(
        names_,
        [this](const std::string& robot) {
          const auto shown = shown_.find(robot);
          return shown != shown_.end() && shown->second != number_;
        },
        last_alive_);
    for (const std::string& robot : served_) {
      sessions_->subscribe(robot, filter_of(robot), Qos::at_least_once, true, now());
      sessions_->keep(robot, last_alive_, std::chrono::seconds{2}, now());
    }
    sessions_->on_broker_up(is_v5_, false, now());
    drain();
  }
  void stop(bool is_stopped) {
    is_stopped_ = is_stopped;
    const auto links = links_;
    for (const auto& [robot, link] : links) broker_.stop_reading(link, is_stopped);
  }
  bool is_running() const { return !is_stopped_ && !is_down_; }

 private:
  /// A command that the mesh has taken and not delivered yet.
  struct Open {
    std::string robot;
    BrokerMessage message;
    std::int64_t came_ms = 0;
    std::int64_t due_ms = 0;
  };

  Now now() const { return {TimePoint{milliseconds{start_ms + broker_.time_ms()}}, {}}; }
  std::int64_t age_ms(const Open& open) const {
    return broker_.time_ms() - open.came_ms + open.message.waited.count();
  }
  /// Forwards the commands that the mesh has not delivered to the gateway that serves the robot
  /// now.
  bool give_up(const std::string& robot) {
    const auto shown = shown_.find(robot);
    if (shown == shown_.end() || shown->second == number_) return false;
    served_.erase(robot);
    std::erase_if(open_, [&](Open& open) {
      if (open.robot != robot) return false;
      open.message.waited = Waited(static_cast<std::uint32_t>(age_ms(open)));
      broker_.publish(
          {names_.mailbox_topic(robot), encode_waiting({open.message}), Qos::at_least_once, false});
      ++ledger_.handed_on;
      return true;
    });
    return true;
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
    hearing.on_suback = alive([this, robot](const std::string& filter, bool is_granted) {
      sessions_->on_subscribed(robot, filter, is_granted, now());
    });
    hearing.on_fence =
        alive([this, robot](std::uint64_t number) { sessions_->on_fence(robot, number, now()); });
    hearing.on_closed = alive([this, robot] { sessions_->on_detached(robot, now()); });
    links_[robot] = broker_.connect(names_.client_id(robot), open.is_clean, std::move(hearing));
  }
  void perform(CloseSession& close) {
    broker_.disconnect(links_.at(close.robot), close.is_forgotten);
  }
  void perform(SubscribeSession& subscribe) {
    broker_.subscribe(links_.at(subscribe.robot), subscribe.filter, subscribe.id,
                      subscribe.wants_retained);
  }
  void perform(UnsubscribeSession& unsubscribe) {
    broker_.unsubscribe(links_.at(unsubscribe.robot), unsubscribe.filter);
  }
  void perform(AskFence& fence) { broker_.fence(links_.at(fence.robot), fence.number); }
  void perform(SendMarker& marker) {
    broker_.publish({names_.mailbox_topic(marker.robot), to_bytes(marker.text), Qos::at_least_once},
                    links_.at(marker.robot));
  }
  void perform(SessionHeld& held) {
    shown_[held.robot] = number_;
    lost_.erase(held.robot);
  }
  void perform(SessionLost& lost) {
    if (lost.why == LossReason::taken) lost_.insert(lost.robot);
  }
  void perform(NoteRead& read) {
    const Bytes note = read.note.value_or(Bytes{});
    if (note.empty()) return subscribe(read.robot, filter_of(read.robot));
    sessions_->subscribe(read.robot, std::string(as_text(note)), Qos::at_least_once, true, now());
  }
  void perform(FilterAnswered& answer) {
    if (unanswered_.erase({answer.robot, answer.filter}) == 0 && answer.is_granted)
      ++ledger_.answered_twice;
    if (answer.is_granted && answer.filter == filter_of(answer.robot))
      broker_.publish(
          {names_.note_topic(answer.robot), to_bytes(answer.filter), Qos::at_least_once, true});
  }
  void perform(TakeMessage& taken) {
    if (taken.is_unasked)
      ++ledger_.fate_of(taken.robot, taken.message).outcomes;
    else
      open_.push_back({taken.robot, taken.message, broker_.time_ms(),
                       broker_.time_ms() + std::uniform_int_distribution<int>(0, 1500)(random_)});
  }
  void perform(RefuseStale& refuse) {
    ++ledger_.fate_of(refuse.robot, refuse.message).outcomes;
    ++ledger_.refused_as_stale;
  }
  void perform(auto&) {}

  const std::size_t number_;
  BrokerModel& broker_;
  const bool is_v5_;
  Ledger& ledger_;
  RobotPresence& shown_;
  const SessionNames names_{TopicScheme("p", "g")};
  std::minstd_rand random_{1};
  unsigned life_ = 0;
  bool is_stopped_ = false;
  bool is_down_ = false;
  TimePoint last_alive_{milliseconds{start_ms}};
  std::unique_ptr<RobotSessions> sessions_;
  std::map<std::string, BrokerModel::Connection> links_;
  std::set<std::string> served_;  ///< by the mesh; on disk
  std::set<std::string> lost_;    ///< the other gateway is not known yet
  std::vector<Open> open_;
  std::map<std::pair<std::string, std::string>, std::int64_t> unanswered_;
};

struct World {
  static constexpr std::size_t robots = 10;
  static constexpr std::int64_t end_ms = 160'000;
  static constexpr std::int64_t all_down_ms = 60'000;
  static constexpr std::int64_t all_up_ms = 100'000;

  World(unsigned seed, BrokerModel::Kind kind)
      : random(seed), broker(seed + 1, kind), is_v5(kind != BrokerModel::Kind::v3_1_1) {}

  int pick(int n) { return std::uniform_int_distribution<int>(0, n - 1)(random); }
  static std::string name(std::size_t robot) { return "r" + std::to_string(robot); }

  void play() {
    for (std::int64_t time = 0; time < end_ms; time += 50) {
      broker.run_until(time);
      // A gateway that takes a session while another one sorts it cannot tell which commands are
      // stale.
      const bool is_sorting = time >= all_up_ms && time < all_up_ms + 3000;
      const bool is_quiet = time < 2000 || time > end_ms - 40'000 || is_sorting;
      move_robots(is_quiet);
      for (std::size_t g = 0; g < gateways.size(); ++g) break_gateway(g, time, is_quiet);
      if (time > 2000 && time < end_ms - 35'000) publish(time);
    }
    broker.run_until(end_ms);
  }
  void move_robots(bool is_quiet) {
    for (std::size_t i = 0; i < robots; ++i) {
      if (!is_quiet && pick(60) == 0) place[i] = static_cast<std::size_t>(pick(3));
      if (pick(4) == 0) gateways[place[i]].hear(name(i));
      if (pick(200) == 0) gateways[place[i]].subscribe(name(i), filter_of(name(i)));
      if (pick(400) == 0) gateways[place[i]].subscribe(name(i), "p/robot/forbidden");
    }
  }
  void break_gateway(std::size_t g, std::int64_t time, bool is_quiet) {
    WorldGateway& gateway = gateways[g];
    gateway.tick([&](const std::string& robot) {
      return place[static_cast<std::size_t>(robot.back() - '0')] == g;
    });
    if (time == all_down_ms) kill(g);
    if (time == all_up_ms) gateway.begin();
    if (time >= all_down_ms && time <= all_up_ms) return;
    if (!gateway.is_running() && time >= stopped_until[g]) gateway.stop(false);
    if (is_quiet || !gateway.is_running()) return;
    const int fate = pick(400);
    if (fate == 0) {
      kill(g);
      gateway.begin();
    }
    if (fate == 1) gateway.cut();
    if (fate == 2) {
      gateway.stop(true);
      stopped_until[g] = time + 3000 + pick(10'000);
    }
  }
  /// Kills the gateway. The others see its last will, and answer for its robots.
  void kill(std::size_t g) {
    gateways[g].kill();
    for (auto shown = shown_by.begin(); shown != shown_by.end();) {
      if (shown->second != g) {
        ++shown;
        continue;
      }
      for (std::size_t other = 0; other < gateways.size(); ++other)
        if (other != g) gateways[other].adopt(shown->first);
      shown = shown_by.erase(shown);
    }
  }
  void publish(std::int64_t time) {
    const std::string robot = name(static_cast<std::size_t>(pick(robots)));
    const std::string payload = std::to_string(ledger.commands.size());
    ++ledger.commands[payload].published;
    broker.publish({"p/server/" + robot + "/run", to_bytes(payload), Qos::at_least_once});
    if (time > all_down_ms && time < all_up_ms - 26'000) stale.insert(payload);
    for (const char* each : {"r0", "r2"}) {
      if (time % 200 != 0) break;
      ++ledger.equal[each].published;
      broker.publish(
          {std::string("p/server/") + each + "/go", to_bytes(equal_payload), Qos::at_least_once});
    }
    if (!is_v5 || time % 1000 != 0) return;
    const std::string unasked_payload = "unasked " + payload;
    ++ledger.commands[unasked_payload].published;
    unasked.insert(unasked_payload);
    broker.publish({"p/server/r1/other", to_bytes(unasked_payload), Qos::at_least_once});
  }

  std::minstd_rand random;
  BrokerModel broker;
  const bool is_v5;
  Ledger ledger;
  RobotPresence shown_by;
  std::array<WorldGateway, 3> gateways{WorldGateway{0, broker, is_v5, ledger, shown_by},
                                       WorldGateway{1, broker, is_v5, ledger, shown_by},
                                       WorldGateway{2, broker, is_v5, ledger, shown_by}};
  std::array<std::size_t, robots> place{};
  std::array<std::int64_t, 3> stopped_until{};
  std::set<std::string> stale;    ///< published while all gateways were down for too long
  std::set<std::string> unasked;  ///< that no robot has subscribed to
};

TEST(SessionWorld, ObeysNoCommandTwiceAndReportsOneOutcomeEachDespiteFailures) {
  constexpr std::array kinds{BrokerModel::Kind::v5_one, BrokerModel::Kind::v5_copies,
                             BrokerModel::Kind::v3_1_1};
  int published = 0;
  int with_outcome = 0;
  int obeyed = 0;
  for (unsigned seed = 1; seed <= 6; ++seed) {
    World world(seed, kinds[seed % kinds.size()]);
    world.play();
    const Ledger& ledger = world.ledger;
    for (const auto& [payload, fate] : ledger.commands) {
      EXPECT_LE(fate.obeyed, 1) << payload << ", seed " << seed;
      EXPECT_LE(fate.outcomes, 1) << payload << ", seed " << seed;
      published += fate.published;
      with_outcome += fate.outcomes;
      obeyed += fate.obeyed;
    }
    for (const auto& [robot, fate] : ledger.equal) {
      EXPECT_LE(fate.outcomes, fate.published) << "seed " << seed;
      EXPECT_LE(fate.obeyed, fate.published) << "seed " << seed;
      EXPECT_GT(fate.outcomes, fate.published * 98 / 100) << "seed " << seed;
    }
    for (const std::string& payload : world.stale)
      EXPECT_EQ(ledger.commands.at(payload).obeyed, 0) << payload << ", seed " << seed;
    for (const std::string& payload : world.unasked)
      EXPECT_EQ(ledger.commands.at(payload).obeyed, 0) << payload << ", seed " << seed;
    EXPECT_GT(ledger.refused_as_stale, 0) << "seed " << seed;
    EXPECT_GT(ledger.handed_on, 0) << "seed " << seed;
    EXPECT_EQ(ledger.without_answer, 0) << "seed " << seed;
    EXPECT_EQ(ledger.answered_twice, 0) << "seed " << seed;
  }
  EXPECT_GT(published, 10'000);
  EXPECT_GT(obeyed, published / 2);
  // Those that came within one round trip before a connection broke have no outcome.
  EXPECT_GT(with_outcome, published * 99 / 100) << with_outcome << " of " << published;
}

}  // namespace
}  // namespace slamgw::sessions

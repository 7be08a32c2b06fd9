// SPDX-License-Identifier: Apache-2.0
// The sessions of all robots of this gateway, as a pure machine: who is attached when, how many
// CONNECTs are open at once, and what happens when the broker or another gateway goes
// (docs/fleet.md names the rules). The broker decides who holds a session; gateways agree about
// nothing. The shell is io/SessionHost.
#pragma once

#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <unordered_map>

#include "daemon/core/log_throttle.hpp"
#include "daemon/sessions/robot_session.hpp"

namespace slamgw::sessions {

class RobotSessions {
 public:
  static constexpr std::size_t default_max_sessions = 10000;
  /// CONNECTs without an answer; brokers take 2 500 a second, and TLS costs more.
  static constexpr std::size_t max_opening = 32;
  /// Sessions that the broker has yet to forget; it keeps those beyond until they expire.
  static constexpr std::size_t max_forgetting = 1000;
  /// After the broker is back, robots that were not heard are attached this much later, so that a
  /// gateway that hears them comes first.
  static constexpr std::chrono::seconds unheard_delay{5};

  /// Whether a living gateway other than this one shows the robot as its own.
  using ServedElsewhere = std::function<bool(const std::string& robot)>;

  /// `last_alive`: when the gateway's former process ended; nothing where there was none.
  RobotSessions(SessionNames names, ServedElsewhere is_served_elsewhere,
                std::optional<TimePoint> last_alive = {},
                std::size_t max_sessions = default_max_sessions);

  // From the meshes.
  /// A sign of life from an address that has shown that it receives, or from the board.
  void on_heard(const std::string& robot, const Now& now);
  /// Answered by FilterAnswered, unless `is_standing`: then the robot has subscribed to it before
  /// (RobotSession::resume).
  void subscribe(const std::string& robot, const std::string& filter, Qos qos, bool is_standing,
                 const Now& now);
  void unsubscribe(const std::string& robot, const std::string& filter);
  void begin_clean(const std::string& robot, const Now& now);
  /// Answered by NoteRead; at once when the broker is away. Takes the session.
  void read_note(const std::string& robot, const Now& now);
  /// The robot is answered for without having been heard: it was this gateway's before a restart,
  /// or its gateway has died. `after`: others that hear it come first. `unheld_since`: no gateway
  /// has held its session since, if it is not here; nothing: that is not known.
  void keep(const std::string& robot, std::optional<TimePoint> unheld_since, Duration after,
            const Now& now);
  /// No other gateway is about: the robots that wait in keep() are answered for now.
  void attach_kept(const Now& now);
  /// The robot is forgotten, and the broker forgets its session, unless another gateway serves it.
  void forget(const std::string& robot);

  // From the shell.
  /// The gateway's own connection is there; before it no session is opened. `is_other`: another
  /// broker than before, so that all sessions begin anew.
  void on_broker_up(bool is_v5, bool is_other, const Now& now);
  void on_broker_down(const Now& now);
  /// The broker does not answer for now, or does again: subscribers do not wait for a silent one.
  void on_silence(bool is_silent);
  void on_attached(const std::string& robot, bool is_present, const Now& now);
  void on_attach_failed(const std::string& robot, const Now& now);
  void on_detached(const std::string& robot, const Now& now);
  void on_subscribed(const std::string& robot, const std::string& filter, bool is_granted,
                     const Now& now);
  void on_message(const std::string& robot, BrokerMessage message,
                  std::span<const std::uint32_t> ids, const Now& now);
  void on_fence(const std::string& robot, std::uint64_t number, const Now& now);
  /// The daemon ends: closes all, and keeps them at the broker.
  void on_stop();

  std::optional<SessionAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const;
  void on_deadline(const Now& now);

  bool is_held(const std::string& robot) const;
  bool is_contested(const std::string& robot) const;
  std::size_t held() const { return held_; }
  Counters counters() const;

 private:
  RobotSession* find(const std::string& robot) const;
  RobotSession* find_or_make(const std::string& robot, TimePoint now);
  /// Queues the robot for its CONNECT, when it may have one.
  void want(const std::string& robot, RobotSession& session, TimePoint now);
  void open_next();
  void after_opening();
  void end_forgetting(const std::string& robot);
  /// Looks at the session again then, or earlier.
  void wake_at(const std::string& robot, TimePoint when);
  /// What follows each input of a session.
  void settle(const std::string& robot, RobotSession& session, TimePoint now);

  const SessionNames names_;
  const ServedElsewhere is_served_elsewhere_;
  const std::optional<TimePoint> last_alive_;
  const std::size_t max_sessions_;
  ActionQueue<SessionAction> actions_;
  RobotSession::Counts counts_;
  struct Entry {
    std::unique_ptr<RobotSession> session;
    std::optional<TimePoint> wake{};  ///< its one entry in `wakes_`
  };
  std::unordered_map<std::string, Entry> sessions_;
  std::deque<std::string> queue_;  ///< robots whose CONNECT waits for its turn
  std::size_t opening_ = 0;
  std::size_t held_ = 0;
  std::uint64_t attached_ = 0;
  std::uint64_t lost_ = 0;
  bool is_broker_up_ = false;
  bool is_silent_ = false;
  bool is_v5_ = false;
  bool is_stopping_ = false;
  std::set<std::pair<TimePoint, std::string>> wakes_;  ///< sessions to look at again, each once
  std::map<std::string, TimePoint> kept_;              ///< robots to attach unheard, and when
  /// Robots whose sessions the broker is to forget: opened clean, and closed. True while that is
  /// under way.
  std::map<std::string, bool> forgetting_;
  LogThrottle full_throttle_{std::chrono::minutes{10}};
};

}  // namespace slamgw::sessions

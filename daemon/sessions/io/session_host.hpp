// SPDX-License-Identifier: Apache-2.0
// The shell of RobotSessions: the connections of robots' sessions, through libmosquitto on the
// loop's own thread. Thousands share one tick and one TLS context. RobotSessions decides what to
// open.
#pragma once

#include <boost/asio/io_context.hpp>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <variant>

#include "daemon/runtime/machine_driver.hpp"
#include "daemon/runtime/timer.hpp"
#include "daemon/sessions/io/robot_link.hpp"
#include "daemon/sessions/robot_sessions.hpp"

namespace slamgw::sessions {

class SessionHost {
 public:
  /// Actions for the application: the second group of session_action.hpp.
  using Report =
      std::variant<SessionHeld, SessionLost, SessionProven, SessionSorted, FilterAnswered,
                   TakeMessage, RefuseStale, NoteRead, SessionContested, Notice>;

  SessionHost(boost::asio::io_context& io, SessionNames names,
              RobotSessions::ServedElsewhere is_served_elsewhere,
              std::optional<TimePoint> last_alive, std::function<void(Report)> report);
  ~SessionHost() { close_all(); }
  SessionHost(const SessionHost&) = delete;
  SessionHost& operator=(const SessionHost&) = delete;

  /// Calls an input of the machine: `host->on_heard(robot, read_clocks())`.
  MachineDriver<RobotSessions>::Input operator->() { return driver_.operator->(); }
  const RobotSessions& sessions() const { return sessions_; }

  /// Call when the gateway's own connection to this broker is up, or is lost. `is_other`: it is
  /// another broker than before.
  void on_broker_up(RobotBroker broker, bool is_other);
  void on_broker_down();
  /// Closes the connections that RobotSessions::on_stop() lets go; returns true when all are
  /// closed. Call it from a timer: a link that has read several messages reports one by one.
  bool stop_taking() { return driver_->on_stop(); }
  /// Closes all connections without waiting.
  void stop();

 private:
  friend class RobotLink;

  struct AttachFailure {
    std::string why;
    bool is_id_refused = false;     ///< the broker does not let this gateway use the client id
    bool is_without_files = false;  ///< the process may not open more files
  };

  // The links call these on the loop's thread, never from inside a call to a link.
  void on_attach_failed(const std::string& robot, const AttachFailure& failure);
  void on_detached(const std::string& robot, LossReason why);
  void on_subscribed(const std::string& robot, const std::string& filter, bool is_granted);
  void on_no_subscription_ids();

  std::string explain(const std::string& robot, const AttachFailure& failure) const;
  RobotLink* find(const std::string& robot);
  void end_link(const std::string& robot, RobotLink::Farewell farewell);
  void end_links();
  void close_all();
  void on_tick();

  void perform(OpenSession& open);
  void perform(CloseSession& close);
  void perform(SubscribeSession& subscribe);
  void perform(UnsubscribeSession& unsubscribe);
  void perform(AskFence& fence);
  void perform(SendMarker& marker);
  template <class Other>
  void perform(Other& other) {
    report_(std::move(other));
  }

  boost::asio::io_context& io_;
  const SessionNames names_;
  const std::function<void(Report)> report_;
  RobotSessions sessions_;
  MachineDriver<RobotSessions> driver_;
  Timer tick_;
  std::shared_ptr<const RobotBroker> broker_;  ///< the newest; null before the first
  bool has_subscription_ids_ = true;           ///< false: sessions at this broker use MQTT 3.1.1
  std::uint64_t attempts_ = 0;  ///< a host may have several addresses: each attempt tries the next
  std::map<std::string, std::shared_ptr<RobotLink>> links_;
  std::string last_ticked_;  ///< the robot whose link was the last to tick
  bool is_stopped_ = false;
  LogThrottle failure_throttle_{std::chrono::minutes{1}};
  LogThrottle mailbox_throttle_{std::chrono::hours{1}};
};

}  // namespace slamgw::sessions

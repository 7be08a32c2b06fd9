// SPDX-License-Identifier: Apache-2.0
// The shell of RobotSessions: passes its actions to RobotLinks and what comes of them back, and the
// rest to the application.
#pragma once

#include <boost/asio/io_context.hpp>
#include <functional>
#include <set>
#include <string>
#include <variant>

#include "daemon/runtime/machine_driver.hpp"
#include "daemon/sessions/io/robot_links.hpp"
#include "daemon/sessions/robot_sessions.hpp"

namespace slamgw::sessions {

class SessionHost final : private RobotLinksListener {
 public:
  /// What the application does: the second group of session_action.hpp.
  using Report = std::variant<SessionHeld, SessionLost, FilterAnswered, TakeMessage, RefuseStale,
                              NoteRead, SessionContested, Notice>;

  SessionHost(boost::asio::io_context& io, SessionNames names,
              RobotSessions::ServedElsewhere is_served_elsewhere,
              std::optional<TimePoint> last_alive, std::function<void(Report)> report);

  /// Calls an input of the machine: `host->on_heard(robot, read_clocks())`.
  MachineDriver<RobotSessions>::Input operator->() { return driver_.operator->(); }
  const RobotSessions& sessions() const { return sessions_; }
  /// The last try to open the robot's session failed.
  bool is_refused(const std::string& robot) const { return refused_.contains(robot); }

  /// The gateway's own connection is up, or has gone.
  void on_broker_up(const BrokerSettings& broker, MqttVersion version);
  void on_broker_down();
  void stop();

 private:
  void on_ready() override;
  void on_attached(const std::string& robot, bool is_present) override;
  void on_attach_failed(const std::string& robot, const AttachFailure& failure) override;
  void on_detached(const std::string& robot) override;
  void on_subscribed(const std::string& robot, const std::string& filter, bool is_granted) override;
  void on_message(const std::string& robot, BrokerMessage message,
                  std::vector<std::uint32_t> ids) override;
  void on_fence(const std::string& robot, std::uint64_t number) override;

  std::string explain(const std::string& robot, const AttachFailure& failure) const;
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

  const SessionNames names_;
  const std::function<void(Report)> report_;
  RobotSessions sessions_;
  MachineDriver<RobotSessions> driver_;
  RobotLinks links_;
  MqttVersion version_ = MqttVersion::v5;
  std::string uri_;        ///< of the broker that the sessions are at
  bool is_other_ = false;  ///< than the machine knows
  bool is_broker_up_ = false;
  std::set<std::string> refused_;  ///< at most as many as there are sessions
  LogThrottle failure_throttle_{std::chrono::minutes{1}};
  LogThrottle mailbox_throttle_{std::chrono::hours{1}};
};

}  // namespace slamgw::sessions

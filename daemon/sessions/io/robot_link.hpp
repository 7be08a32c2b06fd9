// SPDX-License-Identifier: Apache-2.0
// One connection with a robot's client id, from its CONNECT to its end; never reused. Part of
// RobotLinks.
#pragma once

#include <deque>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/time.hpp"
#include "daemon/mqtt/mosquitto/mosquitto_client.hpp"
#include "daemon/sessions/io/robot_links.hpp"

namespace slamgw::sessions {

class RobotLink final : public MosquittoClient {
 public:
  using MosquittoClient::end;
  using MosquittoClient::Farewell;

  RobotLink(RobotLinks& links, std::shared_ptr<const RobotLinks::Broker> broker, std::string robot);

  void open(const std::string& client_id, bool is_clean, const std::string& address,
            TimePoint give_up_at);
  void subscribe(const std::string& filter, Qos qos, std::uint32_t id, bool wants_retained);
  void unsubscribe(const std::string& filter) {
    must_be_sent(MosquittoClient::unsubscribe(filter));
  }
  void ask_fence(std::uint64_t number, const std::string& own_topic);
  void publish(const std::string& topic, const std::string& text);
  void on_tick(TimePoint now);

 private:
  /// A session without what it was to send is of no use.
  std::optional<int> must_be_sent(std::optional<int> packet_id);

  void on_connack(const Connack& connack) override;
  void on_ended(const Ended& ended) override;
  void on_confirmed(const Confirmed& confirmed) override;
  void on_subscribed(const Subscribed& subscribed) override;
  void on_arrived(Arrived& arrived) override;

  RobotLinks& links_;
  const std::shared_ptr<const RobotLinks::Broker> broker_;
  const std::string robot_;
  TimePoint give_up_at_{};
  std::vector<std::pair<int, std::string>> subscribing_;  ///< packet ids and filters
  std::deque<std::pair<int, std::uint64_t>> fences_;      ///< packet ids and numbers
};

}  // namespace slamgw::sessions

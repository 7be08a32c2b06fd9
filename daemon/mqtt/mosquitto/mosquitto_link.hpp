// SPDX-License-Identifier: Apache-2.0
// The broker link through libmosquitto. Only the goodbye runs on the lane.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/thread_pool.hpp>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "daemon/mqtt/connection_probe.hpp"
#include "daemon/mqtt/mosquitto/mosquitto_client.hpp"
#include "daemon/mqtt/mosquitto/publish_properties.hpp"
#include "daemon/mqtt/mqtt_link.hpp"
#include "daemon/mqtt/tls_client.hpp"
#include "daemon/runtime/timer.hpp"

namespace slamgw {

class MosquittoLink final : public MqttLink, public MosquittoClient {
 public:
  MosquittoLink(boost::asio::io_context& io, boost::asio::thread_pool& lane, LinkOptions options,
                MqttLinkListener& listener);

  void connect() override;
  void publish(std::uint64_t sequence, const BrokerMessage& message) override;
  void subscribe(std::string filter) override;
  void unsubscribe(std::string filter) override;
  void abandon(bool is_orderly) override;

 private:
  std::shared_ptr<MosquittoLink> self() {
    return std::static_pointer_cast<MosquittoLink>(shared_from_this());
  }

  void on_connack(const Connack& connack) override;
  void on_ended(const Ended& ended) override;
  void on_confirmed(const Confirmed& confirmed) override;
  void on_subscribed(const std::string& filter, bool is_granted) override;
  void on_arrived(Arrived& arrived) override;
  void fail(ConnectFailure failure);
  ConnectFailure explain_failure(const Ended& ended) const;
  std::string explain_loss(const Ended& ended) const;

  boost::asio::thread_pool& lane_;
  const LinkOptions options_;
  const BrokerSettings& settings_;  ///< of `options_`
  MqttLinkListener& listener_;
  Timer timeout_;
  Timer tick_;
  bool has_failed_ = false;                                 ///< on_connect_failed() was called
  std::vector<std::pair<int, std::uint64_t>> in_flight_;    ///< packet ids and sequences, in order
  std::vector<std::pair<int, std::string>> unsubscribing_;  ///< packet ids and filters
  PublishProperties properties_;
};

/// Makes a MosquittoLink, as MakeLink requires.
std::shared_ptr<MqttLink> make_mosquitto_link(boost::asio::io_context& io,
                                              boost::asio::thread_pool& lane, LinkOptions options,
                                              MqttLinkListener& listener);

}  // namespace slamgw

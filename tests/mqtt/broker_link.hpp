// SPDX-License-Identifier: Apache-2.0
// An Upstream with a loop of its own and a listener that records its reports.
#pragma once

#include <gtest/gtest.h>

#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include "daemon/mqtt/configured_link.hpp"
#include "daemon/mqtt/upstream.hpp"
#include "tests/support/broker_of_version.hpp"
#include "tests/support/eventually.hpp"

namespace slamgw {

/// Records the reports of the link.
struct RecordingListener final : UpstreamListener {
  void on_link_up(const BrokerLimits& said) override {
    ++ups;
    limits = said;
    is_up = true;
  }
  void on_link_down(const std::string& why) override {
    reasons.push_back(why);
    is_up = false;
  }
  void on_link_left(const std::string& why) override {
    departures.push_back(why);
    is_up = false;
  }
  void on_silence(bool is_silent) override { silences += is_silent ? 1 : 0; }
  void on_published(std::uint64_t sequence) override { published.insert(sequence); }
  void on_publish_refused(std::uint64_t sequence, const Refusal& refusal) override {
    refused[sequence] = refusal;
  }
  void on_subscribe_result(const std::string& filter, bool is_granted) override {
    subscribed[filter] = is_granted;
  }
  void on_message(BrokerMessage message, const UserProperties& said) override {
    message.sender = sender_of(said);
    messages.push_back(std::move(message));
  }

  int ups = 0;
  int silences = 0;
  bool is_up = false;
  BrokerLimits limits;
  std::vector<std::string> reasons;
  std::vector<std::string> departures;
  std::set<std::uint64_t> published;
  std::map<std::uint64_t, Refusal> refused;
  std::map<std::string, bool> subscribed;
  std::vector<BrokerMessage> messages;
};

inline BrokerSettings settings_for(std::uint16_t port,
                                   std::optional<Credentials> credentials = {}) {
  BrokerSettings settings;
  settings.port = port;
  settings.client_id = "slam-gateway-test";
  settings.credentials = std::move(credentials);
  return settings;
}

using test::BrokerOfVersion;
using test::either_version;
using test::name_of;

inline std::string name_of(MqttClient client) {
  return client == MqttClient::paho ? "Paho" : "Mosquitto";
}
inline const auto each_client = testing::Values(MqttClient::paho, MqttClient::mosquitto);

/// A test of what holds with each client library.
class WithEachClient : public testing::TestWithParam<MqttClient> {
 public:
  static BrokerSettings settings_for(std::uint16_t port,
                                     std::optional<Credentials> credentials = {}) {
    BrokerSettings settings = slamgw::settings_for(port, std::move(credentials));
    settings.client = GetParam();
    return settings;
  }
  static std::string name(const testing::TestParamInfo<MqttClient>& client) {
    return name_of(client.param);
  }
};

/// A test of what holds with each client library and either version.
class WithEachClientAndVersion
    : public testing::TestWithParam<std::tuple<MqttClient, MqttVersion>> {
 public:
  static MqttVersion version() { return std::get<MqttVersion>(GetParam()); }
  static BrokerSettings settings_for(std::uint16_t port) {
    BrokerSettings settings = slamgw::settings_for(port);
    settings.client = std::get<MqttClient>(GetParam());
    return settings;
  }
  static std::string name(const testing::TestParamInfo<ParamType>& info) {
    return name_of(std::get<MqttClient>(info.param)) + name_of(std::get<MqttVersion>(info.param));
  }
};

struct Link {
  explicit Link(const BrokerSettings& settings, Upstream::ReadCredentials read = {},
                std::chrono::seconds longest_answer = std::chrono::minutes{1}) {
    ConnectionTraits traits{make_configured_link, {"gw/state", R"({"state":"offline"})"}};
    traits.longest_answer = longest_answer;
    upstream = std::make_unique<Upstream>(io, settings, std::move(traits), listener);
    upstream->read_credentials_with(std::move(read));
    upstream->start();
  }
  bool sees(const std::function<bool()>& condition) { return test::eventually(io, condition); }
  bool comes_up() {
    return sees([this] { return listener.is_up; });
  }

  boost::asio::io_context io;
  RecordingListener listener;
  std::unique_ptr<Upstream> upstream;
};

}  // namespace slamgw

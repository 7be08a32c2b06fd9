// SPDX-License-Identifier: Apache-2.0
// The page's own connection, at a real Mosquitto.
#include "web/server/io/broker_link.hpp"

#include <gtest/gtest.h>

#include "tests/support/mosquitto.hpp"

namespace slamgw::web {
namespace {

/// The first reason that the broker is away.
std::string refusal_of(const test::Mosquitto& broker, std::optional<Credentials> credentials,
                       bool tls = false) {
  BrokerSettings settings;
  settings.port = broker.port();
  settings.tls = tls;
  settings.credentials = std::move(credentials);
  boost::asio::io_context io;
  std::string refusal;
  BrokerLink::Listener listener;
  listener.on_state = [&](bool, const std::string& why) {
    refusal = why;
    io.stop();
  };
  const auto work = boost::asio::make_work_guard(io);
  const BrokerLink link(io, settings, {"a/#"}, listener);
  io.run_for(std::chrono::seconds(30));
  return refusal;
}

TEST(WebBrokerLink, NamesTheUserThatTheBrokerRefusesAndTheFile) {
  const test::Mosquitto broker({}, "page", "right");
  const std::string wrong = refusal_of(broker, Credentials{"page", "wrong"});
  EXPECT_NE(wrong.find("('page'): correct web-credentials.json"), wrong.npos) << wrong;
  EXPECT_EQ(wrong.find("wrong"), wrong.npos) << "no password in a log";
  const std::string none = refusal_of(broker, std::nullopt);
  EXPECT_NE(none.find("(no user name was sent)"), none.npos) << none;
}

TEST(WebBrokerLink, NamesWhatIsWrongWithTls) {
  const test::Mosquitto broker;
  const std::string why = refusal_of(broker, std::nullopt, true);
  EXPECT_EQ(why.find("TLS with 127.0.0.1 fails: "), 0U) << why;
}

}  // namespace
}  // namespace slamgw::web

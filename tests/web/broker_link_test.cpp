// SPDX-License-Identifier: Apache-2.0
// The page's own connection, at a real Mosquitto.
#include "web/server/io/broker_link.hpp"

#include <gtest/gtest.h>

#include "tests/support/mosquitto.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::web {
namespace {

/// The first reason that the broker is away.
std::string refusal_of(const test::Mosquitto& broker,
                       std::optional<std::string> credentials_file = {}, bool tls = false) {
  BrokerSettings settings;
  settings.port = broker.port();
  settings.tls = tls;
  settings.credentials_file = std::move(credentials_file);
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
  const test::TempDir directory;
  const std::string file = directory / "web-credentials.json";
  test::write_file(file, R"({"username": "page", "password": "not it"})", 0600);
  const std::string wrong = refusal_of(broker, file);
  EXPECT_NE(wrong.find("(user 'page' from " + file + "): correct that file"), wrong.npos) << wrong;
  EXPECT_EQ(wrong.find("not it"), wrong.npos) << "no password in a log";
  const std::string none = refusal_of(broker);
  EXPECT_NE(none.find("(no user name was sent): give one in web-credentials.json"), none.npos)
      << none;
}

TEST(WebBrokerLink, NamesWhatIsWrongWithTls) {
  const test::Mosquitto broker;
  const std::string why = refusal_of(broker, std::nullopt, true);
  EXPECT_NE(why.find("TLS"), why.npos) << why;
}

}  // namespace
}  // namespace slamgw::web

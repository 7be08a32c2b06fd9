// SPDX-License-Identifier: Apache-2.0
#include "web/server/io/page_hub.hpp"

#include <gtest/gtest.h>

#include "tests/support/eventually.hpp"
#include "tests/support/free_port.hpp"

namespace slamgw::web {
namespace {

TEST(PageHub, BoundsConcurrentMetricsRequests) {
  boost::asio::io_context io;
  Config config;
  config.broker.port = test::free_tcp_port();  // no broker listens there
  PageHub hub(io, config, {}, "1");
  std::string made;
  const auto ask = [&](char name) {
    hub.make_metrics([&made, name, place = hub.begin_scrape()](const std::string&) {
      EXPECT_TRUE(place);
      made += name;
    });
  };
  ask('a');
  ask('b');
  EXPECT_EQ(hub.begin_scrape(), nullptr);
  EXPECT_TRUE(test::eventually(io, [&] { return made == "ab"; })) << made;
  EXPECT_TRUE(hub.begin_scrape());
  hub.end();
}

}  // namespace
}  // namespace slamgw::web

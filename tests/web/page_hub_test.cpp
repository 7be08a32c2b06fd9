// SPDX-License-Identifier: Apache-2.0
#include "web/server/io/page_hub.hpp"

#include <gtest/gtest.h>

#include "tests/support/eventually.hpp"
#include "tests/support/free_port.hpp"

namespace slamgw::web {
namespace {

TEST(PageHub, MakesNoMetricsForAClientThatIsGone) {
  boost::asio::io_context io;
  Config config;
  config.broker.port = test::free_tcp_port();  // no broker listens there
  PageHub hub(io, config, {}, "1");
  std::string made;
  const auto ask = [&](const std::shared_ptr<void>& place, char name) {
    hub.make_metrics(place, [&made, name](const std::string&) { made += name; });
  };
  std::shared_ptr<void> first = hub.begin_scrape();
  std::shared_ptr<void> second = hub.begin_scrape();
  ask(first, 'a');
  ask(second, 'b');
  EXPECT_EQ(hub.begin_scrape(), nullptr);
  second.reset();
  const std::shared_ptr<void> third = hub.begin_scrape();
  ASSERT_NE(third, nullptr);
  ask(third, 'c');
  EXPECT_TRUE(test::eventually(io, [&] { return made == "ac"; })) << made;
  hub.end();
}

}  // namespace
}  // namespace slamgw::web

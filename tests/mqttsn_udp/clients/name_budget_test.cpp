// SPDX-License-Identifier: Apache-2.0
// A subscription is charged for the memory that it takes, here and in the robot's broker session.
#include "adapters/mqttsn_udp/clients/topic_table.hpp"

#include <gtest/gtest.h>
#include <malloc.h>

#include <functional>
#include <utility>

#include "daemon/sessions/robot_sessions.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

constexpr unsigned clients = 32;
constexpr unsigned filters_each = 64;

/// Returns the allocated octets for each octet that is charged.
double octets_for_each_charged(const std::function<std::string(unsigned)>& filter_of) {
  SnRig rig;
  sessions::RobotSessions at_broker(sessions::SessionNames(TopicScheme("ntnu-slam", "gw")),
                                    [](const auto&) { return false; });
  for (unsigned n = 1; n <= clients; ++n) rig.connect(n, "r" + std::to_string(n));
  std::size_t charged = 0;
  const std::size_t before = mallinfo2().uordblks;
  for (unsigned i = 0; i < clients * filters_each; ++i) {
    const std::string filter = filter_of(i);
    rig.subscribe(1 + i % clients, filter);
    at_broker.subscribe("r" + std::to_string(1 + i % clients), filter, Qos::at_least_once, false,
                        {rig.now, {}});
    charged += NameBudget::of_filter(filter.size());
  }
  rig.filters.clear();  // the rig's own copies do not count
  std::exchange(rig.subscribes, {}).clear();
  std::exchange(rig.datagrams, {}).clear();
  const std::size_t after = mallinfo2().uordblks;
  return after < before ? 0 : static_cast<double>(after - before) / static_cast<double>(charged);
}

TEST(NameBudget, ChargesFiltersForTheirMemory) {
  const double ordinary =
      octets_for_each_charged([](unsigned i) { return "a/robot-" + std::to_string(i) + "/+"; });
  if (ordinary == 0) GTEST_SKIP() << "the allocator of this build counts nothing";
  EXPECT_LT(ordinary, 2);
  EXPECT_LT(octets_for_each_charged([](unsigned i) {
              std::string filter = "a/" + std::to_string(i);
              for (int level = 2; level < 63; ++level) filter += "/x";
              return filter + "/+";
            }),
            1.25);
  EXPECT_LT(octets_for_each_charged([](unsigned i) {
              return "a/" + std::to_string(i) + "/" + std::to_string(i) + "/" + std::to_string(i);
            }),
            2);
}

}  // namespace
}  // namespace slamgw::mqttsn

// SPDX-License-Identifier: Apache-2.0
// When gateways that have connected in the same moment send their beats.
#include <array>
#include <memory>

#include "tests/fleet/newcomer.hpp"

namespace slamgw::fleet::test {
namespace {

/// A broker that has been restarted: all gateways are back at once.
class Beats : public testing::Test {
 protected:
  static constexpr std::size_t gateways = 40;
  static constexpr Duration period = 500ms;

  void SetUp() override {
    for (std::size_t i = 0; i < gateways; ++i)
      fleet.push_back(std::make_unique<Ownership>(FleetTopics("p", "room-" + std::to_string(i)),
                                                  Settings{Enabled::yes, 0x10000},
                                                  [] { return std::vector<LocalRobot>{}; }));
    for (auto& gateway : fleet) gateway->on_broker_link(true, at(0ms));
  }
  static Now at(Duration after) { return {TimePoint{} + 1h + after, {}}; }
  static std::size_t beats_of(Ownership& gateway) {
    std::size_t count = 0;
    while (const auto action = gateway.next_action()) {
      const auto* said = std::get_if<PublishNow>(&*action);
      const auto read = said ? decode("any", said->message.payload) : std::nullopt;
      count += read && std::holds_alternative<Beat>(read->body) ? 1 : 0;
    }
    return count;
  }
  std::vector<std::unique_ptr<Ownership>> fleet;
};

TEST_F(Beats, OfGatewaysThatConnectAtOnceAreSpreadOverThePeriod) {
  constexpr std::size_t parts = 5;
  std::array<std::size_t, parts> sent{};
  for (Duration after{}; after < 10s; after += 1ms) {
    for (auto& gateway : fleet) {
      gateway->on_deadline(at(after));
      const std::size_t beats = beats_of(*gateway);
      if (after >= 9s)
        sent.at(static_cast<std::size_t>(after % period / (period / parts))) += beats;
    }
  }
  for (const std::size_t each : sent) {
    EXPECT_GT(each, 2 * gateways / parts / 4);
    EXPECT_LT(each, 2 * gateways / parts * 2);
  }
}

TEST_F(Beats, ComeWithoutAGapLongerThanAPeriod) {
  for (auto& gateway : fleet) {
    Duration last{};
    std::size_t beats = 0;
    for (Duration after{}; after < 3s; after += 1ms) {
      gateway->on_deadline(at(after));
      if (beats_of(*gateway) == 0) continue;
      EXPECT_LE(after - last, period);
      last = after;
      ++beats;
    }
    EXPECT_GE(beats, 6U);
    EXPECT_LE(beats, 7U) << "one more than in a steady rhythm";
  }
}

}  // namespace
}  // namespace slamgw::fleet::test

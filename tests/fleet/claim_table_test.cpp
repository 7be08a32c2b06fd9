// SPDX-License-Identifier: Apache-2.0
// Claims as one gateway remembers them, and how gateways that have missed some get them.
#include "daemon/fleet/claim_table.hpp"

#include <fmt/format.h>

#include "tests/fleet/newcomer.hpp"

namespace slamgw::fleet::test {
namespace {

using Claims = std::vector<std::pair<std::string, std::uint64_t>>;

TEST(ClaimTable, DigestsDoNotDependOnTheOrderOfClaims) {
  ClaimTable a;
  ClaimTable b;
  a.set("r1", {1, "gw-0", 7}, {});
  a.set("r2", {5, "gw-0", 7}, {});
  b.set("r2", {4, "gw-1", 7}, {});
  b.set("r1", {1, "gw-0", 7}, {});
  EXPECT_NE(a.digest_of("gw-0", 7), b.digest_of("gw-0", 7));
  b.set("r2", {5, "gw-0", 7}, {});
  EXPECT_EQ(a.digest_of("gw-0", 7), b.digest_of("gw-0", 7));
  EXPECT_EQ(b.digest_of("gw-1", 7), ClaimTable::Digest{});
  EXPECT_EQ(a.claims_of("gw-0", 7), (Claims{{"r1", 1}, {"r2", 5}}));
}

TEST(ClaimTable, ForgetsOneLifeOfAGateway) {
  ClaimTable table;
  for (int i = 0; i < 1000; ++i)
    table.set(fmt::format("r{:03}", i), {1, "gw-0", static_cast<Life>(i % 2)}, {});
  table.erase_life("gw-0", 1);
  EXPECT_EQ(table.size(), 500U);
  EXPECT_FALSE(table.find("r001"));
  EXPECT_EQ(table.find("r998")->claim, (Claim{1, "gw-0", 0}));
  EXPECT_EQ(table.owners(), (std::vector<ClaimTable::Owner>{{"gw-0", 0}}));
  EXPECT_EQ(table.claims_of("gw-0", 0).size(), 500U);
  EXPECT_EQ(table.claims_of("gw-0", 1).size(), 0U);
}

/// A gateway that others hear and ask.
class Asked : public Newcomer {
 protected:
  void SetUp() override {
    ownership.on_broker_link(true, at(0s));
    state_comes("gw-1", 0s);
  }
  void beat_comes(const std::string& gateway, Duration after, std::uint64_t claims) {
    ownership.on_fleet_message({gateway, 7, Beat{after / 1ms, 500, claims, claims, 0}}, at(after));
  }
  void ask_comes(const std::string& gateway, Duration after) {
    ownership.on_fleet_message({gateway, 7, AskTable{}}, at(after));
  }
  /// Topics on which such messages went out since the last call.
  template <typename Kind>
  std::vector<std::string> published() {
    std::vector<std::string> topics;
    while (const auto action = ownership.next_action()) {
      const auto* said = std::get_if<PublishNow>(&*action);
      const auto read = said ? decode("gw-0", said->message.payload) : std::nullopt;
      if (read && std::holds_alternative<Kind>(read->body)) topics.push_back(said->message.topic);
    }
    return topics;
  }
};

TEST_F(Asked, ManyThatAskAtOnceForItsClaimsGetThemInOneMessage) {
  for (int i = 1; i <= 20; ++i) beat_comes(fmt::format("gw-{}", i), 100ms, 0);
  for (int i = 1; i <= 20; ++i) ask_comes(fmt::format("gw-{}", i), 150ms);
  EXPECT_EQ(published<Table>(), std::vector<std::string>{"p/fleet/to/gw-1/gw-0"});
  ASSERT_TRUE(ownership.deadline());
  EXPECT_LE(*ownership.deadline(), at(350ms).mono);
  ownership.on_deadline(at(350ms));
  EXPECT_EQ(published<Table>(), std::vector<std::string>{"p/fleet/all/gw-0"});
  ownership.on_deadline(at(1s));
  EXPECT_EQ(published<Table>(), std::vector<std::string>{});
  ask_comes("gw-9", 1100ms);
  EXPECT_EQ(published<Table>(), std::vector<std::string>{"p/fleet/to/gw-9/gw-0"});
}

TEST_F(Asked, AsksAGatewayThatIsBackAtItsFirstBeat) {
  others_answered(0s);
  // As a member, which asks only after two beats that differ, for a claim may overtake a beat.
  for (int i = 0; i < 100 && ownership.phase() != Ownership::Phase::member; ++i) {
    const Duration after = 100ms * i;
    beat_comes("gw-1", after, 0);
    ownership.on_fleet_message({"gw-0", ownership.life(), Beat{(1h + after) / 1ms, 500, 0, 0, 0}},
                               at(after));
    ownership.on_deadline(at(after));
  }
  ASSERT_EQ(ownership.phase(), Ownership::Phase::member);
  published<AskTable>();
  beat_comes("gw-1", 10s, 1);
  EXPECT_EQ(published<AskTable>(), std::vector<std::string>{"p/fleet/to/gw-1/gw-0"});
  beat_comes("gw-1", 10500ms, 0);
  beat_comes("gw-1", 13s, 0);
  published<AskTable>();
  beat_comes("gw-1", 13100ms, 1);
  EXPECT_EQ(published<AskTable>(), std::vector<std::string>{});
  beat_comes("gw-1", 13200ms, 1);
  EXPECT_EQ(published<AskTable>(), std::vector<std::string>{"p/fleet/to/gw-1/gw-0"});
}

}  // namespace
}  // namespace slamgw::fleet::test

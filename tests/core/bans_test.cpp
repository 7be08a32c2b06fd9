// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/bans.hpp"

#include <arpa/inet.h>
#include <gtest/gtest.h>

#include "daemon/core/robot_names.hpp"

namespace slamgw {
namespace {

IpNetwork::Address address(const char* text) {
  IpNetwork::Address out{};
  inet_pton(AF_INET6, text, out.data());
  return out;
}

TEST(Bans, CoverAddressesAndNetworks) {
  const Bans bans({"fd00::1", "fd01::/64", "10.1.2.3", "192.168.8.0/21"});
  for (const char* const inside : {"fd00::1", "fd01::", "fd01::ffff:1", "::ffff:10.1.2.3",
                                   "::ffff:192.168.8.0", "::ffff:192.168.15.255"})
    EXPECT_TRUE(bans.covers(address(inside))) << inside;
  for (const char* const outside : {"fd00::2", "fd01:0:0:1::", "::ffff:10.1.2.4", "::10.1.2.3",
                                    "::ffff:192.168.16.0", "::ffff:192.168.7.255"})
    EXPECT_FALSE(bans.covers(address(outside))) << outside;
  EXPECT_FALSE(bans.has("fd00::1")) << "an address is not a robot's name";
  const Bans as_shown({"[fd02::1]:47193", "[fe80::1%4]:40000", "fe80::2%wpan0", "10.1.2.4:4000"});
  for (const char* const inside : {"fd02::1", "fe80::1", "fe80::2", "::ffff:10.1.2.4"})
    EXPECT_TRUE(as_shown.covers(address(inside))) << inside;
  EXPECT_FALSE(Bans().covers(address("::")));
  EXPECT_TRUE(Bans({"::/0"}).covers(address("fd00::1")));
}

TEST(Bans, AreRobotsAddressesAndNetworks) {
  for (const char* const good : {"r1", "robot one", "fd00::1", "fd00::/64", "10.0.0.0/8", "::/0"})
    EXPECT_TRUE(Bans::is_valid(good)) << good;
  for (const char* const bad : {"", "a/b", "fd00::/129", "10.0.0.0/33", "10.0.0.0/4294967200",
                                "10.0.0.0/", "fd00::/x", "fe80::%4/64", "r#"})
    EXPECT_FALSE(Bans::is_valid(bad)) << bad;
}

TEST(Bans, AreTheSameWhenTheyCoverTheSame) {
  const std::pair<const char*, const char*> same[] = {
      {"r1", "r1"},
      {"127.0.0.1/8", "127.0.0.0/8"},
      {"::ffff:127.0.0.1", "127.0.0.1"},
      {"127.0.0.1/32", "127.0.0.1"},
      {"::ffff:10.0.0.0/104", "10.9.9.9/8"},
      {"fd00::1/63", "FD00:0:0:1::/63"},
      {"::1/0", "::/0"},
  };
  for (const auto& [one, other] : same) EXPECT_TRUE(Bans::are_same(one, other)) << one;
  const std::pair<const char*, const char*> different[] = {
      {"r1", "R1"},
      {"127.0.0.1", "127.0.0.2"},
      {"127.0.0.0/8", "127.0.0.0/9"},
      {"127.0.0.1", "127.0.0.0/8"},
      {"::127.0.0.1", "127.0.0.1"},
      {"fd00::1/64", "FD00:0:0:1::/64"},
  };
  for (const auto& [one, other] : different) EXPECT_FALSE(Bans::are_same(one, other)) << one;
}

TEST(Bans, ARobotIsRefusedUnderEachOfItsNames) {
  const std::vector<RobotName> names{{"lego", std::nullopt, "thread-1"}};
  EXPECT_EQ(RobotNames(names).of_client("thread-1"), "lego");
  EXPECT_EQ(RobotNames(names, Bans({"lego"})).of_client("thread-1"), std::nullopt);
  EXPECT_EQ(RobotNames(names, Bans({"thread-1"})).of_client("thread-1"), std::nullopt);
  EXPECT_EQ(RobotNames(names, Bans({"other"})).of_client("thread-1"), "lego");
  EXPECT_EQ(RobotNames(names, Bans({"other"})).of_client("other"), std::nullopt);
  for (const char* const banned : {"lego", "thread-1"})
    EXPECT_TRUE(RobotNames(names, Bans({banned})).is_client_banned("thread-1")) << banned;
  EXPECT_FALSE(RobotNames(names, Bans({"other"})).is_client_banned("thread-1"));
  EXPECT_TRUE(RobotNames(names, Bans({"lego"})).is_banned("lego"));
  EXPECT_TRUE(RobotNames(names, Bans({"thread-1"})).is_banned("lego"));
  EXPECT_FALSE(RobotNames(names, Bans({"other"})).is_banned("lego"));
  EXPECT_FALSE(RobotNames({{"lego", 0x0100, "thread-1"}}, Bans({"thread-1"})).is_banned("lego"))
      << "it still has its name on the other mesh";
}

TEST(RobotNames, NameWithAnAddressIsAcceptedOnlyFromThatAddress) {
  const RobotNames names({{"lego", 0x0100, "thread-1", {}, "fd00::/64"},
                          {"tank", {}, {}, {}, "192.0.2.7"},
                          {"free", {}, "thread-3"}});
  for (const char* const name : {"lego", "thread-1"}) {
    EXPECT_TRUE(names.may_come_from(name, address("fd00::5"))) << name;
    EXPECT_FALSE(names.may_come_from(name, address("fd01::5"))) << name;
  }
  EXPECT_EQ(names.of_client("tank"), "tank") << "its client id is its id";
  EXPECT_TRUE(names.may_come_from("tank", address("::ffff:192.0.2.7")));
  EXPECT_FALSE(names.may_come_from("tank", address("::ffff:192.0.2.8")));
  for (const char* const name : {"free", "thread-3", "stranger"})
    EXPECT_TRUE(names.may_come_from(name, address("fd01::5"))) << name;
}

}  // namespace
}  // namespace slamgw

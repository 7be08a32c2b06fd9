// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/robot_names.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

const RobotNames names({{"NRF_5", 0x0100, "nrf-five"}, {"NRF_6", 0x0101, std::nullopt}});

TEST(RobotNames, NamesConfiguredRobotsOnBothMeshes) {
  EXPECT_EQ(names.of_ble(0x0100), "NRF_5");
  EXPECT_EQ(names.of_client("nrf-five"), "NRF_5");
  EXPECT_EQ(names.ble_address_of("NRF_6"), 0x0101);
}

TEST(RobotNames, NamesOthersByTheirAddress) {
  EXPECT_EQ(names.of_ble(0x01ab), "ble-01ab");
  EXPECT_EQ(names.of_client("robot1"), "robot1");
  EXPECT_EQ(names.ble_address_of("ble-01ab"), 0x01ab);
}

TEST(RobotNames, ComparesClientIdsWhole) {
  EXPECT_EQ(names.of_client("nrf-fiv"), "nrf-fiv");
  EXPECT_EQ(names.of_client("nrf-five0"), "nrf-five0");
}

TEST(RobotNames, GivesNoClientTheNameOfAnotherClient) {
  EXPECT_EQ(names.of_client("NRF_5"), std::nullopt);
}

TEST(RobotNames, GivesNoClientTheNameOfABleRobot) {
  EXPECT_EQ(names.of_client("NRF_6"), std::nullopt) << "it has a BLE address only";
  for (const char* name : {"ble-0100", "ble-0042", "ble-01AB", "ble-01ab"})
    EXPECT_EQ(names.of_client(name), std::nullopt) << name;
  EXPECT_EQ(names.of_client("ble-robot"), "ble-robot");
}

TEST(RobotNames, EntryWithOnlyAnAddressReservesNoName) {
  const RobotNames placed({{"robot1", std::nullopt, std::nullopt, RobotOrigin{1, 2, 3}},
                           {"ble-0042", std::nullopt, std::nullopt, RobotOrigin{}}});
  EXPECT_EQ(placed.of_client("robot1"), "robot1");
  EXPECT_EQ(placed.ble_address_of("ble-0042"), 0x0042);
}

TEST(RobotNames, FindsNoBleAddressForOtherRobots) {
  EXPECT_EQ(names.ble_address_of("robot1"), std::nullopt);
  EXPECT_EQ(names.ble_address_of("ble-zzzz"), std::nullopt);
  EXPECT_EQ(names.ble_address_of("ble-01a"), std::nullopt);
  EXPECT_EQ(names.ble_address_of("ble-0100"), std::nullopt) << "0x0100 is named NRF_5";
}

}  // namespace
}  // namespace slamgw

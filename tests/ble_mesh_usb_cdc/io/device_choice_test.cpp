// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/io/device_choice.hpp"

#include <gtest/gtest.h>

namespace slamgw::ble {
namespace {

UsbPort usb(std::string path, std::uint16_t vendor, std::uint16_t product) {
  return {std::move(path), vendor, product, "0123"};
}

TEST(DeviceChoice, ChoosesOnlyBoardAndNeverThreadCoProcessor) {
  const auto chosen =
      choose_device({usb("/dev/ttyACM0", 0x1915, 0xcafe), usb("/dev/ttyACM1", 0x1366, 0x0105),
                     usb("/dev/ttyUSB0", 0x0403, 0x6001)});
  ASSERT_TRUE(chosen.has_value());
  EXPECT_EQ(chosen->path, "/dev/ttyACM1");
  EXPECT_TRUE(choose_device({usb("/dev/ttyACM0", 0x1915, 0x520f)}).has_value());
  EXPECT_FALSE(choose_device({usb("/dev/ttyACM0", 0x1915, 0xcafe)}).has_value());
  EXPECT_FALSE(choose_device({}).has_value());
}

TEST(DeviceChoice, DoesNotGuessAmongSeveral) {
  const auto chosen =
      choose_device({usb("/dev/ttyACM0", 0x1366, 0x0105), usb("/dev/ttyACM1", 0x1915, 0x520f)});
  ASSERT_FALSE(chosen.has_value());
  EXPECT_NE(chosen.error().why.find("/dev/ttyACM0"), std::string::npos);
  EXPECT_NE(chosen.error().why.find("/dev/ttyACM1"), std::string::npos);
}

TEST(DeviceChoice, ReportsABoardInItsBootLoader) {
  const auto chosen = choose_device({usb("/dev/ttyACM0", 0x1915, 0x521f)});
  ASSERT_FALSE(chosen.has_value());
  EXPECT_NE(chosen.error().why.find("boot loader"), std::string::npos);
}

}  // namespace
}  // namespace slamgw::ble

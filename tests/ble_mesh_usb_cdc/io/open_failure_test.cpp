// SPDX-License-Identifier: Apache-2.0
// Messages for an operator when the serial board's tty can't be opened: cause and remedy.
#include "adapters/ble_mesh_usb_cdc/io/device_choice.hpp"

#include <gtest/gtest.h>

#include <cerrno>

namespace slamgw::ble {
namespace {

const NodeAccess dialout{"dialout", 0660, "slam-gateway"};

std::string explain(int error, const NodeAccess& access = dialout) {
  return explain_open_failure("/dev/ttyAMA0", error, access);
}

TEST(OpenFailure, NamesTheGroupThatMayUseTheTty) {
  EXPECT_EQ(explain(EACCES),
            "/dev/ttyAMA0 can't be opened: Permission denied; only group dialout may use it: sudo "
            "adduser slam-gateway dialout, then restart the daemon");
}

TEST(OpenFailure, SuggestsNoGroupWithoutAccess) {
  for (const NodeAccess& access :
       {NodeAccess{"tty", 0600, "slam-gateway"}, NodeAccess{"root", 0660, "slam-gateway"}}) {
    const std::string why = explain(EACCES, access);
    EXPECT_EQ(why.find("adduser"), std::string::npos) << why;
    EXPECT_NE(why.find("sudo chgrp dialout /dev/ttyAMA0"), std::string::npos) << why;
  }
}

TEST(OpenFailure, DistinguishesSandboxFromFileMode) {
  EXPECT_NE(explain(EPERM).find("DeviceAllow=char-ttyAMA rw"), std::string::npos) << explain(EPERM);
}

TEST(OpenFailure, NamesCommandThatFindsProgramWithTty) {
  for (const int error : {EBUSY, EAGAIN}) {
    EXPECT_EQ(explain(error),
              "/dev/ttyAMA0 is busy: another program has it open; sudo fuser -v /dev/ttyAMA0 shows "
              "which");
  }
}

TEST(OpenFailure, DescribesOtherErrors) {
  EXPECT_NE(explain(EIO).find("Input/output error; check its cable"), std::string::npos);
}

TEST(DeviceChoice, ListsAttachedDevicesWhenThereIsNoBoard) {
  const auto chosen =
      choose_device({{"/dev/ttyACM0", 0x1915, 0xcafe, "1"}, {"/dev/ttyUSB0", 0x0403, 0x6001, "2"}});
  ASSERT_FALSE(chosen.has_value());
  EXPECT_EQ(chosen.error().why,
            "no serial board is attached (looked for USB ids 1366:* and 1915:520f; attached: "
            "/dev/ttyACM0 1915:cafe (a Thread radio), /dev/ttyUSB0 0403:6001): plug one in, or set "
            "ble_mesh.device to its path");
  EXPECT_EQ(choose_device({}).error().why,
            "no serial board is attached (looked for USB ids 1366:* and 1915:520f): plug one in, "
            "or set ble_mesh.device to its path");
}

}  // namespace
}  // namespace slamgw::ble

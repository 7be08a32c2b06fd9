// SPDX-License-Identifier: Apache-2.0
// Provisioning through the serial board, with a host that does its own ECDH: success and each
// failure.
#include <gtest/gtest.h>

#include "tests/simulation/ble/mesh_host.hpp"

namespace slamgw::sim::ble {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

std::vector<std::uint8_t> events_of(const MeshHost& host) {
  std::vector<std::uint8_t> out;
  for (const Bytes& packet : host.packets) {
    if (packet[1] != 0x84) out.push_back(packet[1]);
  }
  return out;
}

TEST(Provisioning, RobotsBeaconEachSecondWhileScanned) {
  MeshHost host(MeshHost::unprovisioned(2));
  host.run(seconds{5});
  host.packets.clear();
  host.tell("01 61");
  host.packets.clear();
  host.run(seconds{3});
  ASSERT_EQ(host.packets.size(), 6U);
  const std::string first = to_hex(host.packets[0]);
  EXPECT_EQ(first.substr(0, 17), "1a c0 73 6c 61 6d");
  EXPECT_EQ(first.substr(first.size() - 23), "00 01 01 00 f9 0b 6e c1");
  EXPECT_NE(Bytes(host.packets[0].begin(), host.packets[0].begin() + 18),
            Bytes(host.packets[1].begin(), host.packets[1].begin() + 18));
  MeshHost again(MeshHost::unprovisioned(2));
  again.tell("01 61");
  EXPECT_EQ(again.await(0xc0)->at(16), 0x01);
  host.tell("01 62");
  host.packets.clear();
  host.run(seconds{3});
  EXPECT_TRUE(host.packets.empty());
}

TEST(Provisioning, CompletesEachStep) {
  MeshHost host(MeshHost::unprovisioned());
  host.set_up();
  host.start_provisioning(0x0123);
  EXPECT_EQ(to_hex(host.await(0xc1).value()), "c1 00");
  EXPECT_EQ(to_hex(host.await(0xc3).value()), "c3 00 01 00 00 00 00 00 00 00 00");
  EXPECT_EQ(host.tell("05 66 00 00 00 00"), "04 84 66 00 00");
  const Bytes request = host.await(0xc7).value();
  ASSERT_EQ(request.size(), 98U);
  EXPECT_EQ(Bytes(request.begin() + 66, request.end()), host.keys.private_key());
  EXPECT_EQ(host.answer_ecdh(request), "04 84 68 00 00");
  const Bytes complete = host.await(0xc5).value();
  EXPECT_EQ(to_hex(ByteView(complete).first(12)), "c5 00 00 00 00 00 00 00 23 01 00 00");
  EXPECT_EQ(Bytes(complete.begin() + 28, complete.end()), hex(MeshHost::net_key));
  const NodeConfiguration& node = host.network().nodes()[0].configuration();
  EXPECT_EQ(Bytes(node.device_key.begin(), node.device_key.end()),
            Bytes(complete.begin() + 12, complete.begin() + 28));
  EXPECT_EQ(node.network->address, 0x0123);
  EXPECT_EQ(to_hex(host.await(0xc2).value()), "c2 00 00");
  host.tell("01 61");
  EXPECT_FALSE(host.await(0xc0, seconds{5}).has_value());  // it sends no more beacons
}

TEST(Provisioning, CompletesOverLossyRadio) {
  BleOptions options = MeshHost::unprovisioned();
  options.common.loss = 0.4;
  MeshHost host(options);
  host.set_up();
  EXPECT_EQ(host.provision(0x0100).size(), 16U);
}

TEST(Provisioning, FailsOnAWrongSecret) {
  MeshHost host(MeshHost::unprovisioned());
  host.set_up();
  const Bytes uuid = host.start_provisioning(0x0100);
  host.await(0xc3);
  host.tell("05 66 00 00 00 00");
  host.await(0xc7);
  Bytes wrong{0x68, 0};
  wrong.resize(34, 0x55);
  host.command(wrong);
  EXPECT_EQ(to_hex(host.await(0xc9).value()), "c9 00 04");
  EXPECT_EQ(to_hex(host.await(0xc2).value()), "c2 00 02");
  EXPECT_EQ(host.provision(0x0100).size(),
            16U);  // it sends beacons again and accepts the right key
}

TEST(Provisioning, FailsOnAPublicKeyOfAnotherPair) {
  MeshHost host(MeshHost::unprovisioned());
  Bytes keypair = host.keys.private_key();
  put(keypair, HostKeyPair().public_key());
  host.start_provisioning(0x0100, keypair);
  host.await(0xc3);
  host.tell("05 66 00 00 00 00");
  host.answer_ecdh(host.await(0xc7).value());
  EXPECT_EQ(to_hex(host.await(0xc9).value()), "c9 00 04");
  EXPECT_EQ(to_hex(host.await(0xc2).value()), "c2 00 02");
}

TEST(Provisioning, FailsOnAPublicKeyOffTheCurve) {
  MeshHost host(MeshHost::unprovisioned());
  host.start_provisioning(0x0100, Bytes(96, 0x11));
  host.await(0xc3);
  host.tell("05 66 00 00 00 00");
  EXPECT_EQ(to_hex(host.await(0xc9).value()), "c9 00 02");
}

class StaticOob : public ::testing::Test {
 protected:
  static BleOptions options() {
    BleOptions out = MeshHost::unprovisioned();
    out.static_oob = hex("6e6f726469635f6578616d706c655f31");
    return out;
  }
  StaticOob() {
    host_.set_up();
    host_.start_provisioning(0x0100);
    caps_ = to_hex(host_.await(0xc3).value());
  }

  MeshHost host_{options()};
  std::string caps_;
};

TEST_F(StaticOob, IsAskedForAfterTheSecret) {
  EXPECT_EQ(caps_, "c3 00 01 00 01 00 00 00 00 00 00");
  EXPECT_EQ(host_.tell("05 66 00 01 00 00"), "03 84 66 84");  // the firmware wants the size 16
  EXPECT_EQ(host_.tell("05 66 00 01 00 10"), "04 84 66 00 00");
  const Bytes request = host_.await(0xc7).value();
  EXPECT_EQ(host_.tell("12 67 00 6e6f726469635f6578616d706c655f31"), "03 84 67 83");
  EXPECT_EQ(host_.tell("11 67 00 6e6f726469635f6578616d706c655f"), "03 84 67 84");
  EXPECT_EQ(host_.answer_ecdh(request), "05 c6 00 01 00 10 | 04 84 68 00 00");
  EXPECT_EQ(host_.tell("12 67 00 6e6f726469635f6578616d706c655f31"), "04 84 67 00 00");
  EXPECT_TRUE(host_.await(0xc5).has_value());
  EXPECT_EQ(to_hex(host_.await(0xc2).value()), "c2 00 00");
}

TEST_F(StaticOob, FailsOnWrongValue) {
  host_.tell("05 66 00 01 00 10");
  host_.answer_ecdh(host_.await(0xc7).value());
  host_.tell("12 67 00 00000000000000000000000000000000");
  EXPECT_EQ(to_hex(host_.await(0xc9).value()), "c9 00 04");
  EXPECT_EQ(to_hex(host_.await(0xc2).value()), "c2 00 02");
}

TEST_F(StaticOob, IsRequiredByDevice) {
  host_.tell("05 66 00 00 00 00");
  EXPECT_EQ(to_hex(host_.await(0xc9).value()), "c9 00 02");
  EXPECT_EQ(to_hex(host_.await(0xc2).value()), "c2 00 02");
}

TEST(Provisioning, GivesEachCommandItsStatus) {
  MeshHost host(MeshHost::unprovisioned());
  const Bytes unknown(16, 0x77);
  EXPECT_EQ(host.command(MeshHost::provision_command(2, unknown, 0x0100)), "03 84 63 87");
  EXPECT_EQ(host.command(MeshHost::provision_command(0, unknown, 0x0100)), "04 84 63 00 00");
  EXPECT_EQ(host.command(MeshHost::provision_command(0, unknown, 0x0100)), "03 84 63 83");
  EXPECT_EQ(host.command(MeshHost::provision_command(1, unknown, 0x0101)), "04 84 63 00 01");
  EXPECT_EQ(host.command(MeshHost::provision_command(1, unknown, 0x0101)), "03 84 63 83");
  EXPECT_EQ(host.tell("05 66 00 00 00 00"), "03 84 66 83");  // out of turn
  EXPECT_EQ(host.tell("02 67 01"), "03 84 67 83");
  EXPECT_EQ(host.tell("03 67 01 00"), "03 84 67 84");
  EXPECT_EQ(host.tell("02 68 00"), "03 84 68 83");  // lengths are not checked
  EXPECT_EQ(host.tell("02 68 02"), "03 84 68 87");
  EXPECT_EQ(host.tell("02 67 09"), "03 84 67 87");
  EXPECT_EQ(host.tell("01 69"), "03 84 69 00");
  EXPECT_EQ(host.tell("01 6a"), "03 84 6a 00");
  EXPECT_EQ(host.tell("01 64"), "03 84 64 00");
  EXPECT_EQ(host.tell("01 6c"), "");
}

TEST(Provisioning, ClosesUnansweredLinkAfterAMinute) {
  MeshHost host(MeshHost::unprovisioned());
  host.command(MeshHost::provision_command(1, Bytes(16, 0x77), 0x0100));
  host.run(seconds{59});
  EXPECT_TRUE(events_of(host) == std::vector<std::uint8_t>{0x81});
  EXPECT_EQ(to_hex(host.await(0xc2, seconds{2}).value()), "c2 01 01");
  EXPECT_EQ(host.command(MeshHost::provision_command(1, Bytes(16, 0x77), 0x0100)),
            "04 84 63 00 01");
}

TEST(Provisioning, ClosesTheLinkOfASilentHostAndTheRobotBeaconsAgain) {
  MeshHost host(MeshHost::unprovisioned());
  const Bytes uuid = host.start_provisioning(0x0100);
  host.await(0xc3);
  host.tell("01 61");
  host.packets.clear();
  host.run(seconds{55});
  EXPECT_TRUE(events_of(host).empty());  // no beacon while the link is open
  EXPECT_EQ(to_hex(host.await(0xc2).value()), "c2 00 01");
  const std::optional<Bytes> beacon = host.await(0xc0, seconds{3});
  ASSERT_TRUE(beacon.has_value());
  EXPECT_EQ(Bytes(beacon->begin() + 1, beacon->begin() + 17), uuid);
}

TEST(Provisioning, RunsTwoLinksAtOnce) {
  MeshHost host(MeshHost::unprovisioned(2));
  host.set_up();
  const Bytes first = host.start_provisioning(0x0100);
  Bytes second = first;
  second[15] = static_cast<std::uint8_t>(3 - first[15]);
  host.command(MeshHost::provision_command(1, second, 0x0101));
  host.await(0xc3);
  host.await(0xc3);
  host.tell("05 66 00 00 00 00");
  host.tell("05 66 01 00 00 00");
  for (int link = 0; link < 2; ++link) host.answer_ecdh(host.await(0xc7).value());
  host.run(seconds{5});
  EXPECT_EQ(events_of(host), (std::vector<std::uint8_t>{0xc5, 0xc5, 0xc2, 0xc2}));
}

TEST(Provisioning, ForgetsItsLinksWhenTheBoardRestarts) {
  MeshHost host(MeshHost::unprovisioned());
  host.set_up();
  host.start_provisioning(0x0100);
  host.await(0xc3);
  host.tell("01 0e");
  EXPECT_EQ(to_hex(host.await(0x81).value()), "81 02 00 fe");
  EXPECT_EQ(host.tell("05 66 00 00 00 00"), "03 84 66 83");
  EXPECT_EQ(host.provision(0x0100).size(), 16U);  // after the robot's own time-out
}

}  // namespace
}  // namespace slamgw::sim::ble

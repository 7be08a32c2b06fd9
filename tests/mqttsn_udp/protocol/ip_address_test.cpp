// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/protocol/endpoint.hpp"

#include <gtest/gtest.h>

namespace slamgw::mqttsn {
namespace {

const IpAddress rloc = {0xfd, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0xff, 0xfe, 0, 0x44, 0};
const IpAddress eid = {0xfd, 0, 0, 0, 0, 0, 0, 1, 0x12, 0x34, 0x56, 0x78, 1, 2, 3, 4};
const IpAddress omr = {0xfd, 0, 0, 0, 0, 0, 0, 2, 0x12, 0x34, 0x56, 0x78, 1, 2, 3, 5};
const IpAddress link_local = {0xfe, 0x80, 0, 0, 0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8};
const IpAddress lan = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff, 192, 0, 2, 1};
const IpAddress no_address{};

TEST(SourceAddress, R16_IsNeverAThreadLocator) {
  const IpAddress robot = {0xfd, 0, 0, 0, 0, 0, 0, 1, 9, 9, 9, 9, 9, 9, 9, 9};
  EXPECT_EQ(choose_source({rloc, link_local, eid}, robot), eid);
  EXPECT_EQ(choose_source({rloc, link_local}, robot), std::nullopt);
}

TEST(SourceAddress, R16_SharesTheRobotsPrefix) {
  IpAddress robot = omr;
  robot[15] = 99;
  EXPECT_EQ(choose_source({eid, omr}, robot), omr);
  EXPECT_EQ(choose_source({eid, omr, link_local}, link_local), link_local);
}

TEST(SourceAddress, R16_IsTheMeshLocalEidForAMulticast) {
  const IpAddress realm = {0xff, 0x03, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1};
  const IpAddress link = {0xff, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1};
  EXPECT_EQ(choose_source({link_local, rloc, omr, eid}, realm), eid);
  EXPECT_EQ(choose_source({omr, eid, rloc}, realm), eid);
  EXPECT_EQ(choose_source({link_local, rloc, omr}, realm), omr);
  EXPECT_EQ(choose_source({rloc, link_local}, realm), std::nullopt);
  EXPECT_EQ(choose_source({rloc, link_local, omr, eid}, link), link_local);
}

TEST(SourceAddress, IsLeftToTheKernelWhereItCannotBeALocator) {
  const IpAddress realm = {0xff, 0x03, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1};
  const IpAddress group = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff, 239, 9, 9, 9};
  EXPECT_EQ(choose_source({link_local, lan}, realm), no_address);
  EXPECT_EQ(choose_source({}, realm), no_address);
  EXPECT_EQ(choose_source({rloc, eid}, group), no_address);
  EXPECT_EQ(choose_source({rloc, lan}, group), lan);
}

}  // namespace
}  // namespace slamgw::mqttsn

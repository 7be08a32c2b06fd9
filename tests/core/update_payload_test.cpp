// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/normalizer.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

// Thesis 6.3: robot at (10, -20), one obstacle at (100, 300), and the stray byte.
const Bytes thesis_update{0x0a, 0x00, 0xec, 0xff, 0x64, 0x00, 0x2c, 0x01, 0x00};

TEST(UpdatePayload, DropsTheStrayByteOfTheThesisRobots) {
  const auto update = parse_update(thesis_update);
  ASSERT_TRUE(update.has_value());
  EXPECT_EQ(update->robot, (Position{10, -20}));
  ASSERT_EQ(update->obstacles.size(), 1u);
  EXPECT_EQ(update->obstacles[0], (Position{100, 300}));
  EXPECT_EQ(to_hex(drop_stray_byte(thesis_update)), "0a00ecff64002c01");
}

TEST(UpdatePayload, AcceptsFourPlusFourNWithAndWithoutTheStrayByteOnly) {
  for (std::size_t size = 0; size <= 30; ++size) {
    const bool is_legal = size >= 4 && size <= 21 && size % 4 <= 1;
    const Bytes payload(size, 0x01);
    const auto update = parse_update(payload);
    EXPECT_EQ(update.has_value(), is_legal) << size << " bytes";
    if (update.has_value()) {
      EXPECT_EQ(update->obstacles.size(), size / 4 - 1);
      EXPECT_EQ(drop_stray_byte(payload).size(), size / 4 * 4);
    }
  }
}

TEST(UpdatePayload, DoesNotReadTheStrayByteAsACount) {
  Bytes bytes = thesis_update;
  bytes.back() = 4;
  const auto update = parse_update(bytes);
  ASSERT_TRUE(update.has_value());
  EXPECT_EQ(update->obstacles.size(), 1u);
}

TEST(UpdatePayload, ReadsTheWholeRangeOfCoordinates) {
  const auto update = parse_update(Bytes{0x00, 0x80, 0xff, 0x7f});
  ASSERT_TRUE(update.has_value());
  EXPECT_EQ(update->robot, (Position{-32768, 32767}));
}

TEST(UpdatePayload, WritesTheJsonOfTheDocumentation) {
  EXPECT_EQ(encode_json(*parse_update(thesis_update)),
            R"({"x":10,"y":-20,"obstacles":[{"x":100,"y":300}]})");
  EXPECT_EQ(encode_json(Update{}), R"({"x":0,"y":0,"obstacles":[]})");
  const Update two{{1, 2}, {{3, 4}, {5, 6}}};
  EXPECT_EQ(encode_json(two), R"({"x":1,"y":2,"obstacles":[{"x":3,"y":4},{"x":5,"y":6}]})");
}

}  // namespace
}  // namespace slamgw

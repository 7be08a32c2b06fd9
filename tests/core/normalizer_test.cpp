// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/normalizer.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

const Bytes update_with_stray_byte{0x0a, 0x00, 0xec, 0xff, 0x77};

TEST(Normalizer, MakesUpdatesCanonical) {
  const Normalized out = normalize("update", update_with_stray_byte, UpdateMode::positions);
  EXPECT_EQ(to_hex(out.payload), "0a00ecff");
  ASSERT_TRUE(out.update);
  EXPECT_FALSE(out.is_rejected);
}

TEST(Normalizer, WritesUpdatesAsJson) {
  const Normalized out = normalize("update", update_with_stray_byte, UpdateMode::json);
  EXPECT_EQ(as_text(out.payload), R"({"x":10,"y":-20,"obstacles":[]})");
}

TEST(Normalizer, LeavesUpdatesAloneInRawMode) {
  EXPECT_EQ(normalize("update", update_with_stray_byte, UpdateMode::raw).payload,
            update_with_stray_byte);
  const Normalized odd = normalize("update", {1, 2, 3}, UpdateMode::raw);
  EXPECT_EQ(odd.payload, (Bytes{1, 2, 3}));
  EXPECT_FALSE(odd.is_rejected);
}

TEST(Normalizer, RejectsUnreadableUpdatesUnchanged) {
  for (const UpdateMode mode : {UpdateMode::positions, UpdateMode::json}) {
    const Normalized out = normalize("update", {1, 2, 3}, mode);
    EXPECT_TRUE(out.is_rejected);
    EXPECT_EQ(out.payload, (Bytes{1, 2, 3}));
  }
}

TEST(Normalizer, PassesEveryOtherTypeUnchanged) {
  const Bytes long_payload(137, 0x5a);  // the robots' format of 2025
  const Normalized out = normalize("adv", long_payload, UpdateMode::json);
  EXPECT_EQ(out.payload, long_payload);
  EXPECT_FALSE(out.update);
  EXPECT_TRUE(normalize("line", {}, UpdateMode::positions).payload.empty());
}

}  // namespace
}  // namespace slamgw

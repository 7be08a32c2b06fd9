// SPDX-License-Identifier: Apache-2.0
// FrameDecoder with every event vector whole, split at every octet and next to others.
#include "adapters/ble_mesh_usb_cdc/nordic/serial_protocol.hpp"

#include <gtest/gtest.h>

#include "tests/ble_mesh_usb_cdc/hex.hpp"
#include "tests/ble_mesh_usb_cdc/nordic/vectors.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

Bytes body(const Bytes& wire) { return {wire.begin() + 1, wire.end()}; }

TEST(Frame, EncodesLengthOpcodeAndParameters) {
  EXPECT_EQ(encode_frame(0x02, as_bytes("hi")), hex("03 02 68 69"));
  EXPECT_EQ(encode_frame(0x02, Bytes(max_frame_params, 7)).front(), 0xff);
}

TEST(FrameDecoder, FindsEveryVectorSplitAtEveryOctet) {
  for (const EventVector& vector : event_vectors) {
    const Bytes wire = hex(vector.wire);
    for (std::size_t cut = 0; cut <= wire.size(); ++cut) {
      FrameDecoder decoder;
      auto frames = decoder.on_bytes(ByteView(wire).first(cut), TimePoint{});
      const auto rest = decoder.on_bytes(ByteView(wire).subspan(cut), TimePoint{} + 100ms);
      frames.insert(frames.end(), rest.begin(), rest.end());
      ASSERT_EQ(frames.size(), 1u) << vector.name << " cut at " << cut;
      EXPECT_EQ(frames.front(), body(wire)) << vector.name << " cut at " << cut;
      EXPECT_FALSE(decoder.deadline());
    }
  }
}

TEST(FrameDecoder, FindsVectorsBackToBack) {
  Bytes all;
  for (const EventVector& vector : event_vectors) all = all + hex(vector.wire);
  FrameDecoder decoder;
  const auto frames = decoder.on_bytes(all, TimePoint{});
  ASSERT_EQ(frames.size(), event_vectors.size());
  for (std::size_t i = 0; i < frames.size(); ++i)
    EXPECT_EQ(frames[i], body(hex(event_vectors[i].wire)));
}

TEST(FrameDecoder, TakesTheLongestFrame) {
  FrameDecoder decoder;
  const Bytes wire = encode_frame(0x82, Bytes(max_frame_params, 0xff));
  ASSERT_EQ(wire.size(), 256u);
  EXPECT_EQ(decoder.on_bytes(wire, TimePoint{}).size(), 1u);
}

TEST(FrameDecoder, LosesSynchronisationAtLengthZero) {
  FrameDecoder decoder;
  const auto frames = decoder.on_bytes(hex("01 90 00 01 91"), TimePoint{});
  EXPECT_EQ(frames.size(), 1u);
  EXPECT_TRUE(decoder.has_lost_step());
  EXPECT_TRUE(decoder.on_bytes(hex("01 90"), TimePoint{}).empty());
  decoder.reset();
  EXPECT_EQ(decoder.on_bytes(hex("01 90"), TimePoint{}).size(), 1u);
}

TEST(FrameDecoder, LosesSynchronisationWhenFrameStaysIncomplete) {
  FrameDecoder decoder;
  decoder.on_bytes(hex("05 84 09"), TimePoint{});
  ASSERT_EQ(decoder.deadline(), TimePoint{} + 250ms);
  decoder.on_deadline(TimePoint{} + 249ms);
  EXPECT_FALSE(decoder.has_lost_step());
  decoder.on_deadline(TimePoint{} + 250ms);
  EXPECT_TRUE(decoder.has_lost_step());
  EXPECT_FALSE(decoder.deadline());
}

}  // namespace
}  // namespace slamgw::ble

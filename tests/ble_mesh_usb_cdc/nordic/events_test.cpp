// SPDX-License-Identifier: Apache-2.0
// Every event against the bytes that Nordic's host script reads.
#include "adapters/ble_mesh_usb_cdc/nordic/serial_protocol.hpp"

#include <gtest/gtest.h>

#include "tests/ble_mesh_usb_cdc/hex.hpp"
#include "tests/ble_mesh_usb_cdc/nordic/vectors.hpp"

namespace slamgw::ble {
namespace {

/// Decodes an event after dropping the length octet, as FrameDecoder does.
Result<Event, DecodeError> decode(std::string_view wire) {
  const Bytes bytes = hex(wire);
  return decode_event(ByteView(bytes).subspan(1));
}

template <class T>
T decode_as(std::string_view wire) {
  const auto event = decode(wire);
  if (!event.has_value() || !std::holds_alternative<T>(*event)) {
    ADD_FAILURE() << wire << " is not that event";
    return {};
  }
  return std::get<T>(*event);
}

TEST(Events, ReadDeviceStarted) {
  EXPECT_EQ(decode_as<DeviceStarted>("04 81 02 01 fe").hardware_error, 1);
}

TEST(Events, ReadCommandResponses) {
  const auto version = decode_as<CommandResponse>("05 84 09 00 0a 00");
  EXPECT_EQ(version.opcode, 0x09);
  EXPECT_EQ(version.status, Status::success);
  EXPECT_EQ(version.data, hex("0a 00"));
  const auto rejected = decode_as<CommandResponse>("03 84 a1 8e");
  EXPECT_EQ(rejected.opcode, 0xa1);
  EXPECT_EQ(rejected.status, Status::rejected);
  EXPECT_TRUE(rejected.data.empty());
  EXPECT_EQ(decode_as<CommandResponse>("03 84 00 84").status, Status::invalid_length);
  EXPECT_EQ(decode_as<CommandResponse>("07 84 ab 00 2a 00 00 00").data, hex("2a 00 00 00"));
}

TEST(Events, ReadMessagesToASubscription) {
  const auto message = decode_as<MessageReceived>(event_vectors[8].wire);
  EXPECT_EQ(message.source, 0x0100);
  EXPECT_EQ(message.key, 0);
  EXPECT_EQ(message.ttl, 8);
  EXPECT_EQ(message.rssi_dbm, -60);
  EXPECT_EQ(message.actual_length, 12);
  EXPECT_EQ(message.payload, hex("c9 59 00 0a 00 ec ff 64 00 2c 01 00"));
  EXPECT_EQ(decode_as<MessageReceived>(event_vectors[9].wire).rssi_dbm, -71);
}

TEST(Events, ReadMessagesToTheGateway) {
  const auto message = decode_as<MessageReceived>(event_vectors[10].wire);
  EXPECT_EQ(message.payload, hex("82 04 01"));
}

TEST(Events, ReadTheNumbersOfTheMesh) {
  decode_as<TxComplete>("05 d2 2a 00 00 00");
  EXPECT_EQ(decode_as<IvUpdate>("05 d3 01 00 00 00").iv_index, 1u);
  EXPECT_EQ(decode_as<Heartbeat>("07 d8 08 02 03 00 00 01").source, 0x0100);
}

TEST(Events, ReadUnknownOpcodesAsOtherEvents) {
  decode_as<OtherEvent>("02 c4 00");
  decode_as<OtherEvent>("02 fe 01");
}

TEST(Events, RefuseTheWrongLength) {
  EXPECT_EQ(decode("03 81 02 00").error(), DecodeError::too_short);
  EXPECT_EQ(decode("05 81 02 00 fe 00").error(), DecodeError::wrong_length);
  EXPECT_EQ(decode("02 84 09").error(), DecodeError::too_short);
  EXPECT_EQ(decode("04 d2 2a 00 00").error(), DecodeError::too_short);
  EXPECT_EQ(decode("08 d8 08 02 03 00 00 01 00").error(), DecodeError::wrong_length);
  EXPECT_EQ(decode("03 d0 00 01").error(), DecodeError::too_short);
  EXPECT_EQ(decode_event({}).error(), DecodeError::too_short);
}

TEST(Events, EveryVectorIsReadAndEveryShorterOneStaysInBounds) {
  for (const EventVector& vector : event_vectors) {
    const Bytes wire = hex(vector.wire);
    EXPECT_TRUE(decode_event(ByteView(wire).subspan(1)).has_value()) << vector.name;
    for (std::size_t size = 0; size + 1 < wire.size(); ++size)
      (void)decode_event(ByteView(wire).subspan(1, size));
  }
}

}  // namespace
}  // namespace slamgw::ble

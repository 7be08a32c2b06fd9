// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/events.hpp"

namespace slamgw::ble {
namespace {

using EventResult = Result<Event, DecodeError>;

constexpr std::size_t max_received_payload = 235;

Bytes to_owned(ByteView bytes) { return {bytes.begin(), bytes.end()}; }

EventResult finish(const ByteReader& params, Event event) {
  if (!params.ok()) return DecodeError::too_short;
  if (!params.at_end()) return DecodeError::wrong_length;
  return event;
}

EventResult decode_started(ByteReader params) {
  DeviceStarted event;
  event.operating_mode = params.read_u8();
  event.hardware_error = params.read_u8();
  params.read_u8();  // data credit: always 254
  return finish(params, event);
}

EventResult decode_response(ByteReader params) {
  CommandResponse event;
  event.opcode = params.read_u8();
  event.status = Status{params.read_u8()};
  event.data = to_owned(params.read_rest());
  return finish(params, std::move(event));
}

EventResult decode_received(ByteReader params, bool is_to_subscription) {
  MessageReceived event;
  event.is_to_subscription = is_to_subscription;
  event.source = params.read_u16_le();
  event.destination = params.read_u16_le();
  event.appkey_handle = params.read_u16_le();
  event.subnet_handle = params.read_u16_le();
  event.ttl = params.read_u8();
  params.read(7);  // advertising address type and address of the last relay
  event.rssi_dbm = static_cast<std::int8_t>(params.read_u8());
  event.actual_length = params.read_u16_le();
  event.payload = to_owned(params.read_rest());
  if (event.payload.size() > max_received_payload) return DecodeError::wrong_length;
  return finish(params, std::move(event));
}

EventResult decode_heartbeat(ByteReader params) {
  Heartbeat event;
  event.initial_ttl = params.read_u8();
  event.hops = params.read_u8();
  event.features = params.read_u16_le();
  event.source = params.read_u16_le();
  return finish(params, event);
}

template <class T>
EventResult decode_number(ByteReader params) {
  const T event{params.read_u32_le()};
  return finish(params, event);
}

}  // namespace

EventResult decode_event(ByteView frame) {
  ByteReader params(frame);
  const std::uint8_t opcode = params.read_u8();
  if (!params.ok()) return DecodeError::too_short;
  switch (opcode) {
    case 0x81: return decode_started(params);
    case 0x82: return Event{EchoResponse{to_owned(params.read_rest())}};
    case 0x84: return decode_response(params);
    case 0xd0: return decode_received(params, false);
    case 0xd1: return decode_received(params, true);
    case 0xd2: return decode_number<TxComplete>(params);
    case 0xd3: return decode_number<IvUpdate>(params);
    case 0xd8: return decode_heartbeat(params);
  }
  if (is_provisioning_event(opcode)) {
    auto event = decode_provisioning_event(frame);
    if (!event.has_value()) return event.error();
    return Event{*event};
  }
  return Event{OtherEvent{opcode}};
}

std::string_view to_string(Status status) {
  switch (status) {
    case Status::success: return "success";
    case Status::unknown_error: return "unknown error";
    case Status::internal: return "internal error";
    case Status::command_unknown: return "command unknown";
    case Status::invalid_state: return "invalid state";
    case Status::invalid_length: return "invalid length";
    case Status::invalid_parameter: return "invalid parameter";
    case Status::busy: return "busy";
    case Status::invalid_data: return "invalid data";
    case Status::rejected: return "rejected";
    case Status::timeout: return "time-out";
    case Status::invalid_key_data: return "invalid key data";
  }
  return "unlisted status";
}

}  // namespace slamgw::ble

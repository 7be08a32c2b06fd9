// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/serial_protocol.hpp"

#include <algorithm>
#include <array>
#include <cassert>

namespace slamgw::ble {

Bytes encode_frame(std::uint8_t opcode, ByteView params) {
  assert(params.size() <= max_frame_params);
  return octets_of(static_cast<std::uint8_t>(params.size() + 1), opcode, params);
}

std::vector<Bytes> FrameDecoder::on_bytes(ByteView bytes, TimePoint now) {
  std::vector<Bytes> frames;
  for (const std::uint8_t byte : bytes) {
    if (has_lost_step_) break;
    if (partial_.empty()) {
      has_lost_step_ = byte == 0;  // the board never sends length 0
      partial_since_ = now;
    }
    partial_.push_back(byte);
    if (partial_.size() == std::size_t{partial_.front()} + 1) {
      if (!has_lost_step_) frames.emplace_back(partial_.begin() + 1, partial_.end());
      partial_.clear();
    }
  }
  return frames;
}

void FrameDecoder::reset() {
  partial_.clear();
  has_lost_step_ = false;
}

std::optional<TimePoint> FrameDecoder::deadline() const {
  if (partial_.empty() || has_lost_step_) return std::nullopt;
  return partial_since_ + max_partial_age;
}

void FrameDecoder::on_deadline(TimePoint now) {
  const auto due = deadline();
  if (due && now >= *due) has_lost_step_ = true;
}

std::string_view sdk_releases(SerialVersion version) {
  switch (version) {
    case SerialVersion::sdk_1_0: return "1.0";
    case SerialVersion::sdk_2_0: return "2.0 or 2.1";
    case SerialVersion::sdk_2_2: return "2.2";
    case SerialVersion::sdk_3_0: return "3.0";
    case SerialVersion::sdk_3_1: return "3.1 to 5.0";
  }
  return {};
}

std::size_t send_limit(SerialVersion version) {
  // The packets of 1.0 and 2.0 are short; 2.1 has the same number as 2.0.
  return version <= SerialVersion::sdk_2_0 ? 88 : 244;
}

Bytes encode_packet_send(const PacketSend& packet, SerialVersion version) {
  Bytes options{0};  // segmented only if the size needs it; in 1.0: "reliable" off
  if (version >= SerialVersion::sdk_2_0) options.push_back(0);  // 32-bit TransMIC
  if (version >= SerialVersion::sdk_3_0)
    options.push_back(0);  // master credentials, not friendship
  return encode_command(CommandOpcode::packet_send, packet.appkey_handle, packet.source,
                        packet.destination_handle, packet.ttl, options, packet.payload);
}

Bytes encode_provision(std::uint8_t context, const ProvisionDevice& device, SerialVersion version) {
  const std::uint16_t network_key_index = 0;
  Bytes options{0, 0};  // no IV update and no key refresh in progress
  if (version >= SerialVersion::sdk_3_0) options.push_back(0);  // no attention signal
  return encode_command(CommandOpcode::provision, context, device.uuid, device.net_key,
                        network_key_index, device.iv_index, device.address, options);
}

Bytes encode_capabilities_set() {
  return encode_command(CommandOpcode::capabilities_set, std::uint8_t{1}, Bytes(8, 0));
}

Bytes encode_oob_use(std::uint8_t context, OobMethod method) {
  // The board takes static data only with the size of a key.
  const std::uint8_t size = method == OobMethod::static_data ? sizeof(Key) : 0;
  return encode_command(CommandOpcode::oob_use, context, static_cast<std::uint8_t>(method),
                        std::uint8_t{0}, size);
}

namespace {

using EventResult = Result<Event, DecodeError>;

constexpr std::size_t max_received_payload = 235;

Bytes to_owned(ByteView bytes) { return {bytes.begin(), bytes.end()}; }

template <std::size_t size>
void read_into(ByteReader& params, std::array<std::uint8_t, size>& out) {
  const ByteView octets = params.read(size);
  std::copy(octets.begin(), octets.end(), out.begin());  // nothing after a short read
}

EventResult finish(const ByteReader& params, Event event) {
  if (!params.ok()) return DecodeError::too_short;
  if (!params.at_end()) return DecodeError::wrong_length;
  return event;
}

EventResult decode_started(ByteReader params) {
  DeviceStarted event;
  params.read_u8();  // operating mode: test, boot loader, application
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

EventResult decode_received(ByteReader params) {
  MessageReceived event;
  event.source = params.read_u16_le();
  params.read(2);  // destination: 0xd0 a unicast address, 0xd1 an address handle
  event.key = params.read_u16_le();
  params.read(2);  // subnet handle
  event.ttl = params.read_u8();
  params.read(7);  // advertising address type and address of the last relay
  event.rssi_dbm = static_cast<std::int8_t>(params.read_u8());
  event.actual_length = params.read_u16_le();
  event.payload = to_owned(params.read_rest());
  if (event.payload.size() > max_received_payload) return DecodeError::wrong_length;
  return finish(params, std::move(event));
}

EventResult decode_beacon(ByteReader params) {
  UnprovisionedBeacon event;
  read_into(params, event.uuid);
  event.rssi_dbm = static_cast<std::int8_t>(params.read_u8());
  params.read(8);  // GATT support, address type and address
  return finish(params, event);
}

EventResult decode_capabilities(ByteReader params) {
  CapabilitiesReceived event;
  event.context = params.read_u8();
  event.elements = params.read_u8();
  params.read_u8();  // public key out of band
  event.static_oob_types = params.read_u8();
  params.read(6);  // output and input OOB: unsupported
  return finish(params, event);
}

EventResult decode_complete(ByteReader params) {
  ProvisioningComplete event;
  event.context = params.read_u8();
  params.read(10);  // IV index, network key index, address, flags
  read_into(params, event.device_key);
  params.read(16);  // the network key
  return finish(params, event);
}

EventResult decode_authentication(ByteReader params) {
  AuthenticationRequested event;
  event.context = params.read_u8();
  event.method = params.read_u8();
  params.read(2);  // action and size
  return finish(params, event);
}

EventResult decode_ecdh(ByteReader params) {
  EcdhRequested event;
  event.context = params.read_u8();
  read_into(params, event.peer);
  params.read(32);  // the private key that the board was given
  return finish(params, event);
}

/// Decodes an event of a provisioning link that has at most a reason.
template <class T>
EventResult decode_link(ByteReader params) {
  T event;
  event.context = params.read_u8();
  if constexpr (requires { event.reason; }) event.reason = params.read_u8();
  if constexpr (requires { event.error; }) event.error = params.read_u8();
  return finish(params, event);
}

}  // namespace

EventResult decode_event(ByteView frame) {
  ByteReader params(frame);
  const std::uint8_t opcode = params.read_u8();
  if (!params.ok()) return DecodeError::too_short;
  switch (opcode) {
    case 0x81: return decode_started(params);
    case 0x82: return Event{EchoResponse{}};
    case 0x84: return decode_response(params);
    case 0xc0: return decode_beacon(params);
    case 0xc1: return decode_link<ProvisioningLinkOpened>(params);
    case 0xc2: return decode_link<ProvisioningLinkClosed>(params);
    case 0xc3: return decode_capabilities(params);
    // 0xc4, 0xc8 and 0xca are for boards that are provisioned themselves.
    case 0xc5: return decode_complete(params);
    case 0xc6: return decode_authentication(params);
    case 0xc7: return decode_ecdh(params);
    case 0xc9: return decode_link<ProvisioningFailed>(params);
    case 0xd0:
    case 0xd1: return decode_received(params);
    case 0xd2:
      params.read(4);  // the token of Packet Send's answer
      return finish(params, TxComplete{});
    case 0xd3: return finish(params, IvUpdate{params.read_u32_le()});
    case 0xd8:
      params.read(4);  // initial TTL, hops, features
      return finish(params, Heartbeat{params.read_u16_le()});
  }
  return Event{OtherEvent{}};
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

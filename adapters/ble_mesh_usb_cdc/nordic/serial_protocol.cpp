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

/// Octets of an event that the daemon does not use.
struct Skip {
  std::size_t count = 0;
};

void read_into(ByteReader& in, Skip skip) { in.read(skip.count); }
void read_into(ByteReader& in, std::uint8_t& value) { value = in.read_u8(); }
void read_into(ByteReader& in, std::uint16_t& value) { value = in.read_u16_le(); }
void read_into(ByteReader& in, std::uint32_t& value) { value = in.read_u32_le(); }
void read_into(ByteReader& in, Status& value) { value = Status{in.read_u8()}; }
template <class Octet>
void read_into(ByteReader& in, std::optional<Octet>& value) {
  value = static_cast<Octet>(in.read_u8());
}
template <std::size_t size>
void read_into(ByteReader& in, std::array<std::uint8_t, size>& value) {
  std::ranges::copy(in.read(size), value.begin());  // nothing after a short read
}
void read_into(ByteReader& in, Bytes& rest) {
  const ByteView octets = in.read_rest();
  rest.assign(octets.begin(), octets.end());
}

/// Decodes an event from its parameters in their order: pointers to its members, or Skip.
template <class T>
EventResult decode(ByteReader& params, const auto&... parameters) {
  T event;
  const auto read = [&](const auto& parameter) {
    if constexpr (requires { event.*parameter; })
      read_into(params, event.*parameter);
    else
      read_into(params, parameter);
  };
  (read(parameters), ...);
  if (!params.ok()) return DecodeError::too_short;
  if (!params.at_end()) return DecodeError::wrong_length;
  return Event(std::move(event));
}

}  // namespace

EventResult decode_event(ByteView frame) {
  ByteReader params(frame);
  const std::uint8_t opcode = params.read_u8();
  if (!params.ok()) return DecodeError::too_short;
  if (params.remaining() > max_frame_params) return DecodeError::wrong_length;
  // Comments name the octets that are skipped.
  switch (opcode) {
    case 0x81:  // operating mode: test, boot loader, application; data credit: always 254
      return decode<DeviceStarted>(params, Skip{1}, &DeviceStarted::hardware_error, Skip{1});
    case 0x82: return Event{EchoResponse{}};
    case 0x84:
      return decode<CommandResponse>(params, &CommandResponse::opcode, &CommandResponse::status,
                                     &CommandResponse::data);
    case 0xc0:  // GATT support, address type and address
      return decode<UnprovisionedBeacon>(params, &UnprovisionedBeacon::uuid,
                                         &UnprovisionedBeacon::rssi_dbm, Skip{8});
    case 0xc1: return decode<ProvisioningLinkOpened>(params, &ProvisioningLinkOpened::context);
    case 0xc2:
      return decode<ProvisioningLinkClosed>(params, &ProvisioningLinkClosed::context,
                                            &ProvisioningLinkClosed::reason);
    case 0xc3:  // public key out of band; output and input OOB: unsupported
      return decode<CapabilitiesReceived>(params, &CapabilitiesReceived::context,
                                          &CapabilitiesReceived::elements, Skip{1},
                                          &CapabilitiesReceived::static_oob_types, Skip{6});
    // 0xc4, 0xc8 and 0xca are for boards that are provisioned themselves.
    case 0xc5:  // IV index, network key index; after the address: flags
      return decode<ProvisioningComplete>(
          params, &ProvisioningComplete::context, Skip{6}, &ProvisioningComplete::address, Skip{2},
          &ProvisioningComplete::device_key, &ProvisioningComplete::net_key);
    case 0xc6:  // action and size
      return decode<AuthenticationRequested>(params, &AuthenticationRequested::context,
                                             &AuthenticationRequested::method, Skip{2});
    case 0xc7:  // the private key that the board was given
      return decode<EcdhRequested>(params, &EcdhRequested::context, &EcdhRequested::peer, Skip{32});
    case 0xc9:
      return decode<ProvisioningFailed>(params, &ProvisioningFailed::context,
                                        &ProvisioningFailed::error);
    case 0xd0:
    case 0xd1:  // destination: 0xd0 a unicast address, 0xd1 an address handle; subnet handle;
                // advertising address type and address of the last relay
      return decode<MessageReceived>(params, &MessageReceived::source, Skip{2},
                                     &MessageReceived::key, Skip{2}, &MessageReceived::ttl, Skip{7},
                                     &MessageReceived::rssi_dbm, &MessageReceived::actual_length,
                                     &MessageReceived::payload);
    case 0xd2: return decode<TxComplete>(params, Skip{4});  // the token of Packet Send's answer
    case 0xd3: return decode<IvUpdate>(params, &IvUpdate::iv_index);
    case 0xd8:  // initial TTL, hops, features
      return decode<Heartbeat>(params, Skip{4}, &Heartbeat::source);
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

// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/provisioning_events.hpp"

#include <algorithm>

namespace slamgw::ble {
namespace {

using ProvisioningEventResult = Result<ProvisioningEvent, DecodeError>;

template <std::size_t size>
void read_array(ByteReader& params, std::array<std::uint8_t, size>& out) {
  const ByteView octets = params.read(size);
  std::copy(octets.begin(), octets.end(), out.begin());  // nothing after a short read
}

ProvisioningEventResult finish_provisioning(const ByteReader& params, ProvisioningEvent event) {
  if (!params.ok()) return DecodeError::too_short;
  if (!params.at_end()) return DecodeError::wrong_length;
  return event;
}

ProvisioningEventResult decode_beacon(ByteReader params) {
  UnprovisionedBeacon event;
  read_array(params, event.uuid);
  event.rssi_dbm = static_cast<std::int8_t>(params.read_u8());
  params.read(8);  // whether it has GATT; address type and address
  return finish_provisioning(params, event);
}

ProvisioningEventResult decode_capabilities(ByteReader params) {
  CapabilitiesReceived event;
  event.context = params.read_u8();
  event.elements = params.read_u8();
  params.read_u8();  // public key out of band
  event.static_oob_types = params.read_u8();
  params.read(6);  // output and input OOB: unsupported
  return finish_provisioning(params, event);
}

ProvisioningEventResult decode_complete(ByteReader params) {
  ProvisioningComplete event;
  event.context = params.read_u8();
  params.read(6);  // IV index and network key index, as they were given
  event.address = params.read_u16_le();
  params.read(2);  // flags
  read_array(params, event.device_key);
  params.read(16);  // the network key
  return finish_provisioning(params, event);
}

ProvisioningEventResult decode_authentication(ByteReader params) {
  AuthenticationRequested event;
  event.context = params.read_u8();
  event.method = params.read_u8();
  params.read(2);  // action and size
  return finish_provisioning(params, event);
}

ProvisioningEventResult decode_ecdh(ByteReader params) {
  EcdhRequested event;
  event.context = params.read_u8();
  read_array(params, event.peer);
  params.read(32);  // the private key that the board was given
  return finish_provisioning(params, event);
}

template <class T>
ProvisioningEventResult decode_octets(ByteReader params) {
  T event;
  event.context = params.read_u8();
  if constexpr (requires { event.reason; }) event.reason = params.read_u8();
  if constexpr (requires { event.error; }) event.error = params.read_u8();
  return finish_provisioning(params, event);
}

}  // namespace

bool is_provisioning_event(std::uint8_t opcode) {
  // 0xc4, 0xc8 and 0xca are for boards that are provisioned themselves.
  return opcode == 0xc9 || (opcode >= 0xc0 && opcode <= 0xc7 && opcode != 0xc4);
}

Result<ProvisioningEvent, DecodeError> decode_provisioning_event(ByteView frame) {
  ByteReader params(frame);
  switch (params.read_u8()) {
    case 0xc0: return decode_beacon(params);
    case 0xc1: return decode_octets<ProvisioningLinkOpened>(params);
    case 0xc2: return decode_octets<ProvisioningLinkClosed>(params);
    case 0xc3: return decode_capabilities(params);
    case 0xc5: return decode_complete(params);
    case 0xc6: return decode_authentication(params);
    case 0xc7: return decode_ecdh(params);
    case 0xc9: return decode_octets<ProvisioningFailed>(params);
  }
  return DecodeError::bad_value;
}

}  // namespace slamgw::ble

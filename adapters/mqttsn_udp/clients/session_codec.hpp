// SPDX-License-Identifier: Apache-2.0
// A session's snapshot as octets for the store, and back. CBOR (RFC 8949) of a map with a
// `version`; members that this version does not know are ignored. Pure; called by SessionKeeper.
#pragma once

#include <optional>

#include "adapters/mqttsn_udp/clients/session_snapshot.hpp"

namespace slamgw::mqttsn {

Bytes encode_session(const SessionSnapshot& snapshot);
/// Nothing when the octets are damaged or of a newer version.
std::optional<SessionSnapshot> decode_session(ByteView content);

}  // namespace slamgw::mqttsn

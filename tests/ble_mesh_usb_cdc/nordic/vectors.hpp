// SPDX-License-Identifier: Apache-2.0
// Golden vectors: commands and events as Nordic's own host script writes and reads them.
#pragma once

#include <array>
#include <string_view>

namespace slamgw::ble {

struct EventVector {
  std::string_view name;
  std::string_view wire;
};

inline constexpr std::array<EventVector, 17> event_vectors{{
    {"device started", "04 81 02 00 fe"},
    {"version reply", "05 84 09 00 0a 00"},
    {"subscription added", "05 84 a1 00 01 00"},
    {"rejected", "03 84 a1 8e"},
    {"sent", "07 84 ab 00 2a 00 00 00"},
    {"tx complete", "05 d2 2a 00 00 00"},
    {"drop counter", "07 84 14 00 03 00 00 00"},
    {"framing error", "03 84 00 84"},
    {"sensor_update set",
     "20 d1 00 01 01 00 00 00 00 00 08 01 c4 3b f9 0b 6e 01 c4 0c 00 c9 59 00 0a 00 ec ff 64 00 2c "
     "01 00"},
    {"sensor_update set_unreliable",
     "1f d1 00 01 01 00 00 00 00 00 07 01 c4 3b f9 0b 6e 01 b9 0b 00 cb 59 00 0a 00 ec ff 64 00 2c "
     "01"},
    {"generic on/off status",
     "17 d0 00 01 01 00 00 00 00 00 08 01 c4 3b f9 0b 6e 01 c9 03 00 82 04 01"},
    {"health current status",
     "18 d0 00 01 01 00 00 00 00 00 08 01 c4 3b f9 0b 6e 01 c9 04 00 04 00 59 00"},
    {"unprovisioned beacon",
     "1a c0 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f c8 00 01 c4 3b f9 0b 6e 01"},
    {"capabilities", "0b c3 00 01 00 00 00 00 00 00 00 00"},
    {"iv update", "05 d3 01 00 00 00"},
    {"heartbeat", "07 d8 08 02 03 00 00 01"},
    {"echo", "03 82 68 69"},
}};

struct CommandVector {
  std::string_view name;
  std::uint8_t opcode;
  std::string_view wire;
};

/// Commands that the daemon does not send, as a check of the framing.
inline constexpr std::array<CommandVector, 13> unused_command_vectors{{
    {"HousekeepingDataClear", 0x15, "01 15"},
    {"RadioReset", 0x0e, "01 0e"},
    {"ScanStart", 0x61, "01 61"},
    {"ScanStop", 0x62, "01 62"},
    {"CapabilitiesSet", 0x6a, "0a 6a 01 00 00 00 00 00 00 00 00"},
    {"Provision", 0x63,
     "2d 63 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f a0 a1 a2 a3 a4 a5 a6 a7 a8 a9 aa ab "
     "ac ad ae af 00 00 00 00 00 00 00 01 00 00 00"},
    {"OobUse", 0x66, "05 66 00 00 00 00"},
    {"EcdhSecret", 0x68,
     "22 68 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f 10 11 12 13 14 15 16 17 18 19 1a 1b "
     "1c 1d 1e 1f"},
    {"DevkeyAdd", 0x9c, "15 9c 00 01 00 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f"},
    {"AddrSubscriptionRemove", 0xa3, "03 a3 03 00"},
    {"StateClear", 0xac, "01 ac"},
    {"Disable", 0x91, "01 91"},
    {"PacketSend on/off unacknowledged", 0xab, "0f ab 00 00 01 00 02 00 08 00 00 00 82 03 00 08"},
}};

}  // namespace slamgw::ble

// SPDX-License-Identifier: Apache-2.0
// Words for the ways in which a broker refuses: Paho gives a number, an operator needs a sentence.
#pragma once

#include <string>

namespace slamgw {

/// `code` is an MQTT 5 reason code (0x80 and up) or an MQTT 3.1.1 CONNACK return code (1-5).
std::string explain_connect_failure(int code);
/// Explains that another client uses our client id.
std::string explain_rival(const std::string& client_id);
/// The reason code of MQTT 5's DISCONNECT when another client uses our id.
inline constexpr int session_taken_over = 0x8e;
bool is_version_refusal(int code);
bool is_not_authorised(int code);
/// Words for an MQTT 5 PUBACK or PUBREC reason code, such as "quota exceeded".
std::string explain_publish_refusal(int reason_code);

}  // namespace slamgw

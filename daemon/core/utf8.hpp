// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <string_view>

namespace slamgw {

/// Well-formed UTF-8 as of RFC 3629: no overlong forms, no surrogates, nothing above U+10FFFF.
bool is_utf8(std::string_view text);

/// UTF-8 that shows as it is written. Not allowed are control characters (U+0000-001F, U+007F-009F,
/// which some terminals obey like escape sequences) and line separators (U+2028, U+2029). The same
/// holds for characters without a width (U+200B and its like), and those that turn the direction of
/// the text after them.
bool is_printable(std::string_view text);

/// Replaces what is_printable() forbids by escapes: `\uXXXX`, as in JSON, and `\xNN` for characters
/// below U+0020 and for octets that are not UTF-8, which a JSON document never contains. Also
/// escapes characters by which a word looks like another one: Greek or Cyrillic letters, marks,
/// spaces and dashes in a word with Latin letters, and words of nothing but look-alikes of these.
std::string escape_unprintable(std::string_view text);

/// Text that every broker takes as a string of MQTT: at most 65 535 octets of well-formed UTF-8
/// without what MQTT 5 section 1.5.4 forbids (U+0000) and without what it advises against: control
/// characters (U+0001-001F, U+007F-009F) and non-characters (U+FDD0-FDEF, the last two code points
/// of each plane). A receiver may close the connection because of any of these, and Mosquitto does
/// for all of them. All robots share one connection, so no such text may reach the broker: every
/// id, topic and filter is checked with this rule where it enters.
bool is_mqtt_text(std::string_view text);

}  // namespace slamgw

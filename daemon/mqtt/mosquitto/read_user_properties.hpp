// SPDX-License-Identifier: Apache-2.0
// The user properties of an MQTT 5 packet as libmosquitto has them (MQTT 5 section 3.3.2.3.7).
#pragma once

#include <mosquitto.h>
#include <mqtt_protocol.h>

#include <cstdlib>
#include <string_view>

namespace slamgw {

/// Calls `take(name, value)` for each, in their order. `list` may be null.
template <class Take>
void read_user_properties(const mosquitto_property* list, Take take) {
  char* name = nullptr;
  char* value = nullptr;
  bool is_next = false;
  while ((list = mosquitto_property_read_string_pair(list, MQTT_PROP_USER_PROPERTY, &name, &value,
                                                     is_next)) != nullptr) {
    is_next = true;
    take(std::string_view(name), std::string_view(value));
    std::free(name);
    std::free(value);
  }
}

}  // namespace slamgw

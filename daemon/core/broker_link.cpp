// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/broker_link.hpp"

#include <fmt/format.h>

namespace slamgw {

std::string in_words(const std::string& filter, SubscribeAnswer answer) {
  if (answer == SubscribeAnswer::closes_connection)
    return fmt::format(
        "the broker closes the connection at the subscription {}: it is set aside for an hour, "
        "and nothing under it reaches robots. Some brokers do that at characters that they do not "
        "take, or at many levels",
        filter);
  return fmt::format(
      "the broker refuses the subscription {}: check its access control list for this gateway's "
      "user",
      filter);
}

}  // namespace slamgw

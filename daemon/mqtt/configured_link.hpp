// SPDX-License-Identifier: Apache-2.0
// The link through the library that `broker.client` names.
#pragma once

#include <memory>
#include <utility>

#include "daemon/mqtt/mosquitto/mosquitto_link.hpp"
#include "daemon/mqtt/paho/paho_link.hpp"

namespace slamgw {

/// Makes the configured link, as MakeLink requires.
inline std::shared_ptr<MqttLink> make_configured_link(boost::asio::io_context& io,
                                                      boost::asio::thread_pool& lane,
                                                      LinkOptions options,
                                                      MqttLinkListener& listener) {
  if (options.broker.client == MqttClient::mosquitto)
    return make_mosquitto_link(io, lane, std::move(options), listener);
  return std::make_shared<PahoLink>(io, lane, std::move(options), listener);
}

}  // namespace slamgw

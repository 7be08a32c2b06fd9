// SPDX-License-Identifier: Apache-2.0
// The I/O shell of BorderRouterWatch: reads otbr-agent's properties over D-Bus, one by one. Other
// properties are keys. So it never asks for all of them, and does not read what a signal carries.
// Loop's thread only.
#pragma once

#include <boost/asio/io_context.hpp>
#include <functional>
#include <string>
#include <vector>

#include "adapters/thread_border_router/border_router_watch.hpp"
#include "daemon/runtime/bus_connection.hpp"
#include "daemon/runtime/machine_driver.hpp"

namespace slamgw::border_router {

class BorderRouter {
 public:
  /// `publish` takes the document of PublishDocument. `bus_address`: as for BusConnection.
  BorderRouter(boost::asio::io_context& io, std::function<void(const std::string& json)> publish,
               std::function<void(Notice&)> report, std::string bus_address = {});

  void start() { connection_.open(); }
  void stop();
  void on_broker_link(bool is_up) { driver_->on_broker_link(is_up); }
  /// See BorderRouterWatch.
  const std::string& role() const { return watch_.role(); }

 private:
  struct Call {
    BorderRouter* router = nullptr;
    SdBusSlot slot = {};
  };

  void on_agent();
  void read();
  void forget_calls();
  static int on_reply(sd_bus_message* reply, void* call, sd_bus_error* error);
  static int on_signal(sd_bus_message* signal, void* router, sd_bus_error* error);

  BorderRouterWatch watch_;
  MachineDriver<BorderRouterWatch> driver_;
  BusConnection connection_;
  std::vector<Call> calls_;  ///< one for each property
  NodeFacts facts_;          ///< from the answers so far
  std::size_t waiting_ = 0;  ///< answers that have not come yet
};

}  // namespace slamgw::border_router

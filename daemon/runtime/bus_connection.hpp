// SPDX-License-Identifier: Apache-2.0
// A connection to D-Bus and to one service there: notices when the service appears and disappears,
// and opens the bus again when the connection breaks. A missing bus or service is a state, not a
// failure. Nothing blocks: the loop runs sd-bus. Loop's thread only.
#pragma once

#include <systemd/sd-bus.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/posix/stream_descriptor.hpp>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "daemon/core/freed_by.hpp"
#include "daemon/runtime/timer.hpp"

namespace slamgw {

using SdBus = std::unique_ptr<sd_bus, FreedBy<sd_bus_close_unref>>;
using SdBusSlot = std::unique_ptr<sd_bus_slot, FreedBy<sd_bus_slot_unref>>;
using SdBusMessage = std::unique_ptr<sd_bus_message, FreedBy<sd_bus_message_unref>>;

class BusConnection {
 public:
  static constexpr std::chrono::seconds reopen_after{2};
  /// Limit of messages in one turn of the loop.
  static constexpr int max_at_once = 64;

  struct Handlers {
    /// Offers objects on a new connection. A negative errno closes it again. May be empty.
    std::function<int(sd_bus*)> on_opened;
    /// The service has appeared or is missing (owner()). `fault`: what is wrong with the bus; may
    /// be empty. Earlier calls on this connection get no answer.
    std::function<void(const std::string& fault)> on_service;
  };

  /// `address` of the bus; empty: the system bus. `service`: its well-known name.
  BusConnection(boost::asio::io_context& io, std::string address, std::string service,
                Handlers handlers);

  void open();
  void close();
  /// Closes the connection, and opens another after `reopen_after`.
  void reopen();
  /// Sends queued messages. Call after using sd-bus from outside its callbacks.
  void watch();
  /// Calls `task` from the loop, unless the connection closes first.
  void post(std::function<void()> task);

  /// Returns null while the connection is closed.
  sd_bus* bus() const { return bus_.get(); }
  /// Returns the unique name of the service's connection; empty while the service is missing.
  const std::string& owner() const { return owner_; }
  /// Makes a call to the owner and not to the name, so that the bus does not start the service.
  SdBusMessage call(const char* path, const char* interface, const char* member) const;

 private:
  int connect();
  void fail(int error);
  void on_ready();
  void set_owner(std::string owner);
  static int on_owner_changed(sd_bus_message* message, void* self, sd_bus_error* error);
  static int on_owner(sd_bus_message* message, void* self, sd_bus_error* error);

  boost::asio::io_context& io_;
  const std::string address_;
  const std::string service_;
  const Handlers handlers_;
  SdBus bus_;
  std::optional<boost::asio::posix::stream_descriptor> socket_;  ///< a duplicate, for waiting
  Timer timer_;  ///< sd-bus's own deadline, or the next attempt to open
  bool is_reading_ = false;
  bool is_writing_ = false;
  std::string owner_;
  /// Each connection has its own. A handler that is still queued when the connection closes finds
  /// it expired, and does nothing.
  std::shared_ptr<void> life_;
};

}  // namespace slamgw

// SPDX-License-Identifier: Apache-2.0
// A D-Bus daemon for one test, without access rules.
#pragma once

#include <gtest/gtest.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/local/stream_protocol.hpp>
#include <filesystem>
#include <string>

#include "daemon/runtime/bus_connection.hpp"
#include "tests/support/child_process.hpp"
#include "tests/support/eventually.hpp"

namespace slamgw::test {

class PrivateBus {
 public:
  explicit PrivateBus(const std::string& socket)
      : socket_(socket),
        daemon_({"dbus-daemon", "--session", "--nofork", "--nopidfile",
                 "--address=" + address_of(socket)}) {
    EXPECT_TRUE(eventually([&] { return takes_connections(); }));
  }
  ~PrivateBus() { std::filesystem::remove(socket_); }
  static std::string address_of(const std::string& socket) { return "unix:path=" + socket; }
  std::string address() const { return address_of(socket_); }

 private:
  /// The socket's file exists before the daemon accepts connections.
  bool takes_connections() const {
    using Local = boost::asio::local::stream_protocol;
    boost::asio::io_context io;
    boost::system::error_code error;
    Local::socket(io).connect(Local::endpoint(socket_), error);
    return !error;
  }

  std::string socket_;
  ChildProcess daemon_;
};

/// A fake service's connection to that daemon; null when there is none.
inline SdBus connect_to_bus(const std::string& address) {
  sd_bus* made = nullptr;
  EXPECT_GE(sd_bus_new(&made), 0);
  SdBus bus(made);
  EXPECT_GE(sd_bus_set_address(made, address.c_str()), 0);
  EXPECT_GE(sd_bus_set_bus_client(made, 1), 0);
  if (sd_bus_start(made) < 0) bus.reset();
  return bus;
}

}  // namespace slamgw::test

// SPDX-License-Identifier: Apache-2.0
// A private network: the gateway's host has the Thread interface `wpan0` and a LAN interface
// `eth0`. Their other ends are on a second host with robots.
#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <string>

#include "tests/mqttsn_udp/io/udp_rig.hpp"
#include "tests/support/network_namespace.hpp"

namespace slamgw::mqttsn {

constexpr std::uint16_t port = 47193;
constexpr const char* eid = "fd00:db8::1234:5678:9abc:def0";
constexpr const char* rloc = "fd00:db8::ff:fe00:4400";
constexpr const char* aloc = "fd00:db8::ff:fe00:fc10";

class ThreadNetwork : public testing::Test {
 protected:
  void SetUp() override {
    gateway_host = test::NetworkNamespace::make();
    robots_host = test::NetworkNamespace::make();
    if (!gateway_host || !robots_host) GTEST_SKIP() << "no right to make network namespaces";
    for (const std::string name : {"wpan0", "eth0"}) {
      make_network(name);
      plug(name);
    }
    home = std::make_unique<test::NetworkNamespace::Visit>(*gateway_host);
  }

  /// Removes the gateway's end of the network.
  void unplug(const std::string& name) { gateway_host->ip("link del " + name); }

  /// Creates the gateway's end, with a new index and the usual addresses.
  void plug(const std::string& name) {
    gateway_host->ip("link add " + name + " address " + mac(name) + " type veth peer name " + name +
                     "-end netns " + robots_host->path());
    robots_host->ip("link set " + name + "-end master " + name + " up");
    gateway_host->ip("link set " + name + " addrgenmode none");
    gateway_host->ip("link set " + name + " up");
    add_addresses(*gateway_host, name, "1");
    if (name == "wpan0") {
      for (const std::string address : {eid, rloc, aloc})
        gateway_host->ip("addr add " + address + "/64 dev wpan0 nodad");
    }
    for (auto* host : {gateway_host.get(), robots_host.get()})
      ASSERT_TRUE(test::eventually([&] { return has_carrier(*host, name); }));
  }

  static Settings settings(const std::string& interface = "*") {
    Settings settings;
    settings.listen = {"[::]:47193"};
    settings.interface = interface;
    settings.multicast_group = "ff03::1";
    return settings;
  }

  /// Returns a robot's socket on this interface of the robots' host.
  boost::asio::ip::udp::socket robot(boost::asio::io_context& io, const std::string& interface,
                                     const std::string& address, std::uint16_t own_port = 0) {
    const test::NetworkNamespace::Visit visit(*robots_host);
    const auto ip = boost::asio::ip::make_address(address);
    boost::asio::ip::udp::socket socket(
        io, ip.is_v6() ? boost::asio::ip::udp::v6() : boost::asio::ip::udp::v4());
    setsockopt(socket.native_handle(), SOL_SOCKET, SO_BINDTODEVICE, interface.data(),
               static_cast<socklen_t>(interface.size()));
    socket.bind({ip, own_port});
    socket.non_blocking(true);
    return socket;
  }

  /// Removes and recreates the interface, as a restart of otbr-agent does.
  void remake(const std::string& name) {
    unplug(name);
    plug(name);
  }

  std::unique_ptr<test::NetworkNamespace> gateway_host;
  std::unique_ptr<test::NetworkNamespace> robots_host;
  std::unique_ptr<test::NetworkNamespace::Visit> home;

 private:
  /// Makes a bridge on the robots' host, so that robots do not notice changes of the gateway's end.
  void make_network(const std::string& name) const {
    robots_host->ip("link add " + name + " type bridge mcast_snooping 0");
    robots_host->ip("link set " + name + " addrgenmode none");
    robots_host->ip("link set " + name + " up");
    add_addresses(*robots_host, name, "2");
    if (name == "wpan0") robots_host->ip("addr add fd00:db8::2/64 dev wpan0 nodad");
  }

  /// Without a carrier the kernel accepts datagrams and drops them.
  static bool has_carrier(const test::NetworkNamespace& host, const std::string& name) {
    const test::NetworkNamespace::Visit visit(host);
    for (const NetworkInterface& interface : read_network_interfaces()) {
      if (interface.name == name) return interface.has_carrier;
    }
    return false;
  }

  /// Returns a fixed address, so that neighbours need no new look-up.
  static std::string mac(const std::string& name) {
    return name == "wpan0" ? "02:00:00:00:00:01" : "02:00:00:00:00:02";
  }

  static void add_addresses(const test::NetworkNamespace& host, const std::string& name,
                            const std::string& n) {
    const std::string network = name == "wpan0" ? "192.0.2." : "198.51.100.";
    host.ip("addr add fe80::" + n + "/64 dev " + name + " nodad");
    host.ip("addr add " + network + n + "/24 dev " + name);
  }
};

}  // namespace slamgw::mqttsn

// SPDX-License-Identifier: Apache-2.0
// Discovery by real multicast, and the networks that are served.
#include <gtest/gtest.h>
#include <net/if.h>

#include <boost/asio/ip/multicast.hpp>
#include <cstring>

#include "tests/mqttsn_udp/io/thread_network.hpp"

namespace slamgw::mqttsn {
namespace {

using boost::asio::ip::make_address;
using boost::asio::ip::udp;
using test::NetworkNamespace;

class Multicast : public ThreadNetwork {
 protected:
  static void search(udp::socket& from, const std::string& group = "ff03::1") {
    from.send_to(boost::asio::buffer(encode(SearchGw{1})), {make_address(group), port});
  }

  void join(udp::socket& socket, const std::string& interface) {
    const NetworkNamespace::Visit visit(*robots_host);
    const int on = 1;
    setsockopt(socket.native_handle(), IPPROTO_IPV6, IPV6_RECVHOPLIMIT, &on, sizeof on);
    socket.set_option(boost::asio::ip::multicast::join_group(make_address("ff03::1").to_v6(),
                                                             if_nametoindex(interface.c_str())));
  }

  /// Returns the hop limit of a received ADVERTISE; 0 if there is none.
  static int hop_limit(udp::socket& socket) {
    Bytes octets(100);
    alignas(cmsghdr) std::uint8_t control[128];
    iovec part{octets.data(), octets.size()};
    msghdr header{};
    header.msg_iov = &part;
    header.msg_iovlen = 1;
    header.msg_control = control;
    header.msg_controllen = sizeof control;
    const ssize_t size = recvmsg(socket.native_handle(), &header, MSG_DONTWAIT);
    if (size < 0) return 0;
    EXPECT_EQ(describe_octets(ByteView(octets).first(static_cast<std::size_t>(size))),
              "ADVERTISE gw=1 duration=900");
    int hops = 0;
    for (cmsghdr* c = CMSG_FIRSTHDR(&header); c; c = CMSG_NXTHDR(&header, c)) {
      if (c->cmsg_type == IPV6_HOPLIMIT) std::memcpy(&hops, CMSG_DATA(c), sizeof hops);
    }
    return hops;
  }
};

TEST_F(Multicast, R19_HearsSearchesOnEveryInterface) {
  UdpRig rig = UdpRig::as_is(settings());
  udp::socket on_thread = robot(rig.io, "wpan0", "fd00:db8::2");
  udp::socket on_lan = robot(rig.io, "eth0", "::");
  for (udp::socket* socket : {&on_thread, &on_lan}) {
    search(*socket);
    EXPECT_EQ(receive(rig.io, *socket), "GWINFO gw=1 address=");
  }
}

TEST_F(Multicast, R19_HearsItsOwnInterfaceOnly) {
  UdpRig rig = UdpRig::as_is(settings("wpan0"));
  udp::socket on_thread = robot(rig.io, "wpan0", "fd00:db8::2");
  udp::socket on_lan = robot(rig.io, "eth0", "::");
  search(on_lan);
  search(on_thread);
  EXPECT_EQ(receive(rig.io, on_thread), "GWINFO gw=1 address=");
  EXPECT_EQ(receive(rig.io, on_lan, nullptr, std::chrono::milliseconds(50)), "nothing");
}

/// Other networks get no answer to unicast either, not even at the Thread interface's address. A
/// host accepts all of its addresses on each interface.
TEST_F(Multicast, ServesItsOwnInterfaceOnly) {
  const auto answer_on_lan = [&](UdpRig& rig, const std::string& address) {
    udp::socket client = robot(rig.io, "eth0", "198.51.100.2");
    client.send_to(boost::asio::buffer(encode(Connect{false, true, 1, 60, "intruder"})),
                   {make_address(address), port});
    return receive(rig.io, client, nullptr, std::chrono::milliseconds(100));
  };
  {
    UdpRig open = UdpRig::as_is(settings());
    EXPECT_EQ(answer_on_lan(open, "198.51.100.1"), "CONNACK code=0") << "all networks are served";
    EXPECT_EQ(answer_on_lan(open, "192.0.2.1"), "CONNACK code=0");
  }
  UdpRig rig = UdpRig::as_is(settings("wpan0"));
  EXPECT_EQ(answer_on_lan(rig, "198.51.100.1"), "nothing");
  EXPECT_EQ(answer_on_lan(rig, "192.0.2.1"), "nothing");
  udp::socket on_thread = robot(rig.io, "wpan0", "192.0.2.2");
  on_thread.send_to(boost::asio::buffer(encode(Connect{false, true, 1, 60, "r1"})),
                    {make_address("192.0.2.1"), port});
  EXPECT_EQ(receive(rig.io, on_thread), "CONNACK code=0");
}

/// The default of `mqttsn.interface`.
class DefaultInterface : public Multicast {
 protected:
  /// Sends a CONNECT from this network to the gateway's address there. Returns the answer.
  std::string answer(UdpRig& rig, const std::string& from) {
    const bool is_near = from == "lo";
    udp::socket client = is_near           ? udp::socket(rig.io, {make_address("127.0.0.1"), 0})
                         : from == "wpan0" ? robot(rig.io, from, "fd00:db8::2")
                                           : robot(rig.io, from, "198.51.100.2");
    client.non_blocking(true);
    const std::string to = is_near ? "127.0.0.1" : from == "wpan0" ? eid : "198.51.100.1";
    client.send_to(boost::asio::buffer(encode(Connect{false, true, 1, 60, from + "-robot"})),
                   {make_address(to), port});
    return receive(rig.io, client, nullptr, std::chrono::milliseconds(300));
  }
  /// Waits until the link has this detail.
  bool comes_to(UdpRig& rig, const std::string& detail) {
    return test::eventually(rig.io, [&] { return rig.core.links.back().detail == detail; });
  }
  static std::uint64_t dropped(UdpRig& rig) {
    for (const Counter& counter : rig.adapter.counters()) {
      if (counter.name == "from_unserved_networks") return counter.value;
    }
    return 0;
  }

  const std::string thread_only = "UDP [::]:47193, only from wpan0 and loopback";
  const std::string all_networks = "UDP [::]:47193, from all networks";
  const std::string accepted = "CONNACK code=0";
};

TEST_F(DefaultInterface, ServesThreadAndLoopback) {
  UdpRig rig = UdpRig::as_is(settings(Settings{}.interface));
  EXPECT_EQ(rig.core.links.back().detail, thread_only);
  EXPECT_EQ(answer(rig, "lo"), accepted);
  EXPECT_EQ(answer(rig, "wpan0"), accepted);
  EXPECT_EQ(dropped(rig), 0U);
  EXPECT_EQ(answer(rig, "eth0"), "nothing");
  EXPECT_EQ(answer(rig, "eth0"), "nothing");
  EXPECT_EQ(dropped(rig), 2U);
  ASSERT_EQ(rig.core.notices.size(), 1U) << "one notice for a burst";
  EXPECT_EQ(rig.core.notices[0].text.find("1 datagrams from networks that are not served"), 0U);
  EXPECT_NE(rig.core.notices[0].text.find("over eth0;"), std::string::npos)
      << rig.core.notices[0].text;
}

TEST_F(DefaultInterface, IgnoresThreadAddressesOverAnotherInterface) {
  UdpRig rig = UdpRig::as_is(settings("auto"));
  udp::socket client = robot(rig.io, "eth0", "198.51.100.2");
  client.send_to(boost::asio::buffer(encode(Connect{false, true, 1, 60, "intruder"})),
                 {make_address("192.0.2.1"), port});
  EXPECT_EQ(receive(rig.io, client, nullptr, std::chrono::milliseconds(100)), "nothing");
}

TEST_F(DefaultInterface, ServesAllNetworksUntilAThreadInterfaceAppears) {
  unplug("wpan0");
  UdpRig rig = UdpRig::as_is(settings("auto"));
  EXPECT_EQ(rig.core.links.back().detail, all_networks);
  EXPECT_EQ(answer(rig, "eth0"), accepted);
  EXPECT_EQ(answer(rig, "lo"), accepted);

  plug("wpan0");
  ASSERT_TRUE(comes_to(rig, thread_only));
  udp::socket on_thread = robot(rig.io, "wpan0", "fd00:db8::2");
  search(on_thread);
  EXPECT_EQ(receive(rig.io, on_thread), "GWINFO gw=1 address=");
  EXPECT_EQ(answer(rig, "wpan0"), accepted);
  EXPECT_EQ(answer(rig, "lo"), accepted);
  EXPECT_EQ(answer(rig, "eth0"), "nothing");
  udp::socket on_lan = robot(rig.io, "eth0", "::");
  const std::uint64_t before = dropped(rig);
  search(on_lan);
  EXPECT_EQ(receive(rig.io, on_lan, nullptr, std::chrono::milliseconds(50)), "nothing");
  EXPECT_EQ(dropped(rig), before) << "the gateway has left the group there";

  unplug("wpan0");
  ASSERT_TRUE(comes_to(rig, all_networks));
  EXPECT_EQ(answer(rig, "lo"), accepted);
  EXPECT_EQ(answer(rig, "eth0"), accepted);
  search(on_lan);
  EXPECT_EQ(receive(rig.io, on_lan), "GWINFO gw=1 address=");
  EXPECT_TRUE(rig.core.links.back().is_up);
}

TEST_F(DefaultInterface, WarnsThatAllNetworksAreServed) {
  UdpRig rig = UdpRig::as_is(settings("*"));
  EXPECT_EQ(answer(rig, "eth0"), accepted);
  ASSERT_EQ(rig.core.notices.size(), 1U);
  EXPECT_EQ(rig.core.notices[0].text.find("MQTT-SN serves every network of this host"), 0U);

  Settings near = settings("*");
  near.listen = {"127.0.0.1:0"};
  UdpRig quiet = UdpRig::as_is(near);
  EXPECT_TRUE(quiet.core.notices.empty()) << "no network reaches the loopback address";
}

TEST_F(Multicast, R19_HearsIpv4GroupsOnASocketForBoth) {
  Settings both = settings();
  both.multicast_group = "239.9.9.9";
  UdpRig rig = UdpRig::as_is(both);
  udp::socket on_lan = robot(rig.io, "eth0", "198.51.100.2");
  udp::endpoint from;
  search(on_lan, "239.9.9.9");
  EXPECT_EQ(receive(rig.io, on_lan, &from), "GWINFO gw=1 address=");
  EXPECT_EQ(from.address(), make_address("198.51.100.1"));
}

TEST_F(Multicast, R16_AnswersASearchFromTheEid) {
  UdpRig rig = UdpRig::as_is(settings("wpan0"));
  udp::socket on_thread = robot(rig.io, "wpan0", "fd00:db8::2");
  udp::endpoint from;
  search(on_thread);
  ASSERT_EQ(receive(rig.io, on_thread, &from), "GWINFO gw=1 address=");
  EXPECT_EQ(from.address(), make_address(eid));
}

TEST_F(Multicast, R17_AnswersFromTheThreadAddressThatWasAsked) {
  UdpRig rig = UdpRig::as_is(settings("wpan0"));
  for (const std::string asked : {eid, rloc, aloc}) {
    udp::socket client = robot(rig.io, "wpan0", "fd00:db8::2");
    client.connect({make_address(asked), port});  // accepts answers from there only
    client.send(boost::asio::buffer(encode(Connect{false, true, 1, 60, "r1"})));
    EXPECT_EQ(receive(rig.io, client), "CONNACK code=0") << asked;
  }
}

TEST_F(Multicast, R18_AdvertisesBeyondTheFirstHopOnEveryInterface) {
  for (const std::string interface : {"wpan0", "eth0"}) {
    boost::asio::io_context io;
    udp::socket listener = robot(io, interface, "::", port);
    join(listener, interface);
    UdpRig rig = UdpRig::as_is(settings());
    int hops = 0;
    EXPECT_TRUE(test::eventually(rig.io, [&] { return (hops = hop_limit(listener)) != 0; }));
    EXPECT_GT(hops, 1) << interface;
  }
}

TEST_F(Multicast, R16_AdvertisesFromTheEid) {
  boost::asio::io_context io;
  udp::socket listener = robot(io, "wpan0", "::", port);
  join(listener, "wpan0");
  UdpRig rig = UdpRig::as_is(settings());
  udp::endpoint from;
  ASSERT_EQ(receive(rig.io, listener, &from), "ADVERTISE gw=1 duration=900");
  EXPECT_EQ(from.address(), make_address(eid));
}

TEST_F(Multicast, R16_KeepsSilentWhileItOnlyHasLocators) {
  gateway_host->ip("addr del " + std::string(eid) + "/64 dev wpan0");
  UdpRig rig = UdpRig::as_is(settings("wpan0"));
  udp::socket searching = robot(rig.io, "wpan0", "fd00:db8::2");
  search(searching);
  udp::socket listener = robot(rig.io, "wpan0", "::", port);
  join(listener, "wpan0");
  gateway_host->ip("addr add " + std::string(eid) + "/64 dev wpan0 nodad");
  udp::endpoint from;
  ASSERT_EQ(receive(rig.io, listener, &from), "ADVERTISE gw=1 duration=900");
  EXPECT_EQ(from.address(), make_address(eid));
  EXPECT_EQ(receive(rig.io, searching, nullptr, std::chrono::milliseconds(50)), "nothing");
}

TEST_F(Multicast, R11_AdvertisesOnlyOnTheInterfaceThatReturns) {
  for (const std::string served : {"*", "auto", "wpan0"}) {
    boost::asio::io_context io;
    udp::socket on_thread = robot(io, "wpan0", "::", port);
    udp::socket on_lan = robot(io, "eth0", "::", port);
    join(on_thread, "wpan0");
    join(on_lan, "eth0");
    UdpRig rig = UdpRig::as_is(settings(served));
    ASSERT_EQ(receive(rig.io, on_thread), "ADVERTISE gw=1 duration=900");
    if (served == "*") {
      ASSERT_EQ(receive(rig.io, on_lan), "ADVERTISE gw=1 duration=900");
    }
    remake("wpan0");
    udp::endpoint from;
    ASSERT_EQ(receive(rig.io, on_thread, &from), "ADVERTISE gw=1 duration=900");
    EXPECT_EQ(from.address(), make_address(eid));
    EXPECT_EQ(receive(rig.io, on_lan, nullptr, std::chrono::milliseconds(50)), "nothing")
        << "the other interface has not changed";
  }
}

TEST_F(Multicast, R19_ServesAgainWhenItsInterfaceReturns) {
  UdpRig rig = UdpRig::as_is(settings("wpan0"));
  unplug("wpan0");
  const auto is_down = [&] { return !rig.core.links.back().is_up; };
  ASSERT_TRUE(test::eventually(rig.io, is_down));
  plug("wpan0");
  ASSERT_TRUE(test::eventually(rig.io, [&] { return rig.core.links.back().is_up; }));
  udp::socket on_thread = robot(rig.io, "wpan0", "fd00:db8::2");
  search(on_thread);
  EXPECT_EQ(receive(rig.io, on_thread), "GWINFO gw=1 address=");
}

TEST_F(Multicast, R19_JoinsTheGroupAgainWhenAnInterfaceReturns) {
  UdpRig rig = UdpRig::as_is(settings());
  unplug("wpan0");
  plug("wpan0");
  udp::socket on_thread = robot(rig.io, "wpan0", "fd00:db8::2");
  const auto is_answered = [&] {  // once the gateway has noticed the interface
    search(on_thread);
    return receive(rig.io, on_thread, nullptr, std::chrono::milliseconds(100)) != "nothing";
  };
  EXPECT_TRUE(test::eventually(is_answered, std::chrono::seconds(8))) << "sooner than by polling";
}

}  // namespace
}  // namespace slamgw::mqttsn

// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/paho/paho_link.hpp"

#include <gtest/gtest.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>

namespace slamgw {
namespace {

using boost::asio::ip::tcp;

class BrokerSocketTest : public testing::Test {
 public:
  BrokerSocketTest() {
    to_broker.connect(broker.local_endpoint());
    to_other.connect(other.local_endpoint());
  }

  static bool has(int option, tcp::socket& socket) {
    int value = 0;
    socklen_t size = sizeof value;
    EXPECT_EQ(getsockopt(socket.native_handle(), IPPROTO_TCP, option, &value, &size), 0);
    return value != 0;
  }

  boost::asio::io_context io;
  tcp::endpoint loopback{boost::asio::ip::address_v4::loopback(), 0};
  tcp::acceptor broker{io, loopback};
  tcp::acceptor other{io, loopback};
  tcp::socket to_broker{io};
  tcp::socket to_other{io};
  BrokerSocket socket;
};

TEST_F(BrokerSocketTest, SendsWithoutDelayToTheBrokersPortOnly) {
  ASSERT_FALSE(has(TCP_NODELAY, to_broker));
  socket.adopt(broker.local_endpoint().port());
  EXPECT_TRUE(has(TCP_NODELAY, to_broker));
  EXPECT_FALSE(has(TCP_NODELAY, to_other));
}

TEST_F(BrokerSocketTest, CorksUntilItReleases) {
  socket.gather();
  EXPECT_FALSE(has(TCP_CORK, to_broker)) << "it has no socket yet";
  socket.adopt(broker.local_endpoint().port());
  socket.gather();
  EXPECT_TRUE(has(TCP_CORK, to_broker));
  EXPECT_FALSE(has(TCP_CORK, to_other));
  socket.release();
  EXPECT_FALSE(has(TCP_CORK, to_broker));
}

TEST_F(BrokerSocketTest, LeavesAnotherSocketAloneAfterItsOwnIsClosed) {
  socket.adopt(broker.local_endpoint().port());
  const int former = to_broker.native_handle();
  to_broker.close();
  tcp::socket next(io);
  next.connect(other.local_endpoint());
  ASSERT_EQ(next.native_handle(), former) << "another socket has the descriptor now";
  socket.gather();
  EXPECT_FALSE(has(TCP_CORK, next));
  socket.forget();
  socket.gather();
  EXPECT_FALSE(has(TCP_CORK, next));
}

}  // namespace
}  // namespace slamgw

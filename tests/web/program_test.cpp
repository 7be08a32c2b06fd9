// SPDX-License-Identifier: Apache-2.0
// The built slam-gateway-web: how it ends when it cannot serve.
#include <gtest/gtest.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>

#include "tests/support/child_process.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::web::test {
namespace {

using boost::asio::ip::tcp;

TEST(WebProgram, SaysInOneSentenceThatItsAddressIsInUse) {
  boost::asio::io_context io;
  const tcp::acceptor other(io, {boost::asio::ip::address_v4::loopback(), 0});
  const std::string address = "127.0.0.1:" + std::to_string(other.local_endpoint().port());
  const slamgw::test::TempDir directory;
  slamgw::test::write_file(directory / "gateway.json",
                           R"({"web": {"listen": ")" + address + "\"}}");
  slamgw::test::ChildProcess web({SLAMGW_WEB, "--config", directory / "gateway.json"},
                                 directory / "out", directory / "err");
  EXPECT_EQ(web.wait(), 1);
  const std::string told = slamgw::test::read_file(directory / "err");
  EXPECT_NE(told.find("web.listen: can't use " + address + ": Address already in use\n"), told.npos)
      << told;
}

}  // namespace
}  // namespace slamgw::web::test

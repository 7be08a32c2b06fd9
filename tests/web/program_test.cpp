// SPDX-License-Identifier: Apache-2.0
// The built slam-gateway-web: how it exits when it cannot serve, and its answers beside clients
// that take many places. All clients come from loopback.
#include <gtest/gtest.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/read.hpp>
#include <boost/asio/write.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/websocket.hpp>
#include <csignal>
#include <list>
#include <optional>
#include <string>

#include "tests/support/child_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/free_port.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::web::test {
namespace {

using boost::asio::ip::tcp;

TEST(WebProgram, NamesAddressInUse) {
  boost::asio::io_context io;
  const tcp::acceptor other(io, {boost::asio::ip::address_v4::loopback(), 0});
  const std::string address = "127.0.0.1:" + std::to_string(other.local_endpoint().port());
  const slamgw::test::TempDir directory;
  slamgw::test::write_file(directory / "gateway.json",
                           R"({"web": {"listen": ")" + address + "\"}}");
  slamgw::test::ChildProcess web({SLAMGW_WEB, "--config", directory / "gateway.json"},
                                 directory / "out", directory / "err");
  EXPECT_EQ(web.wait(), 1);
  const std::string output = slamgw::test::read_file(directory / "err");
  EXPECT_NE(output.find("web.listen: can't use " + address + ": Address already in use\n"),
            output.npos)
      << output;
}

TEST(WebProgram, NamesPortChosenBySystem) {
  const slamgw::test::TempDir directory;
  slamgw::test::write_file(directory / "gateway.json", R"({"web": {"listen": "127.0.0.1:0"}})");
  const slamgw::test::ChildProcess web({SLAMGW_WEB, "--config", directory / "gateway.json"},
                                       directory / "out", directory / "err");
  std::string output;
  EXPECT_TRUE(slamgw::test::eventually([&] {
    output = slamgw::test::read_file(directory / "err");
    return output.find("the page is at http://127.0.0.1:") != output.npos;
  }));
  EXPECT_EQ(output.find("http://127.0.0.1:0/"), output.npos) << output;
}

class WebProgramUnderLoad : public testing::Test {
 protected:
  using Page = boost::beast::websocket::stream<tcp::socket>;
  static constexpr const char* wrong = R"({"topic":"$web/token","payload":"a-wrong-token"})";
  static constexpr const char* right = R"({"topic":"$web/token","payload":"0123456789abcdef"})";
  static constexpr const char* command = R"({"topic":"ntnu-slam/server/r/run","payload":"stop"})";

  void SetUp() override { start("0123456789abcdef\n"); }
  void start(const std::string& tokens) {
    slamgw::test::write_file(directory_ / "token", tokens, 0600);
    slamgw::test::write_file(directory_ / "gateway.json",
                             R"({"web": {"token_file": "token", "listen": "127.0.0.1:)" +
                                 std::to_string(address_.port()) + "\"}}");
    web_.emplace(std::vector<std::string>{SLAMGW_WEB, "--config", directory_ / "gateway.json"},
                 directory_ / "out", directory_ / "err");
    ASSERT_TRUE(slamgw::test::eventually([&] {
      boost::system::error_code error;
      tcp::socket(io_).connect(address_, error);
      return !error;
    })) << slamgw::test::read_file(directory_ / "err");
  }

  tcp::socket ask(const std::string& request) {
    tcp::socket socket(io_);
    socket.connect(address_);
    boost::asio::write(socket, boost::asio::buffer(request));
    return socket;
  }
  std::string status_of_the_page() { return status_of("/"); }
  std::string status_of(const std::string& path, const std::string& header = "") {
    return answer_to("GET " + path + " HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n" +
                     header + "\r\n");
  }
  std::string answer_to(const std::string& request) {
    tcp::socket socket = ask(request);
    std::string status(12, ' ');
    boost::system::error_code error;
    boost::asio::read(socket, boost::asio::buffer(status), error);
    return error ? error.message() : status;
  }
  Page open_page() {
    Page page(io_);
    page.next_layer().connect(address_);
    page.handshake("127.0.0.1", "/api");
    return page;
  }
  static void say(Page& page, const std::string& text) { page.write(boost::asio::buffer(text)); }
  /// Reads up to the message that contains this text.
  static std::string hear(Page& page, const std::string& text) {
    std::string heard;
    while (heard.find(text) == heard.npos) {
      boost::beast::flat_buffer message;
      page.read(message);
      heard += boost::beast::buffers_to_string(message.data());
    }
    return heard;
  }

  const slamgw::test::TempDir directory_;
  const tcp::endpoint address_{boost::asio::ip::address_v4::loopback(),
                               slamgw::test::free_tcp_port()};
  boost::asio::io_context io_;
  std::optional<slamgw::test::ChildProcess> web_;
};

TEST_F(WebProgramUnderLoad, AnswersBesideMoreIncompleteRequestsThanPlaces) {
  std::list<tcp::socket> half;
  for (int i = 0; i < 300; ++i) half.push_back(ask("GET / HTTP/1.1\r\nHo"));
  EXPECT_EQ(status_of_the_page(), "HTTP/1.1 200");
  EXPECT_EQ(status_of_the_page(), "HTTP/1.1 200");
}

TEST_F(WebProgramUnderLoad, RefusesWhatItCannotServe) {
  EXPECT_EQ(answer_to("POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 5\r\n\r\nhello"),
            "HTTP/1.1 405");
  EXPECT_EQ(status_of("/", "Content-Length: 5\r\n"), "HTTP/1.1 400");
  EXPECT_EQ(status_of("/", "Transfer-Encoding: chunked\r\n"), "HTTP/1.1 400");
  EXPECT_EQ(status_of("/", "Host: 127.0.0.1\r\n"), "HTTP/1.1 400");
  EXPECT_EQ(status_of("/", "Content-Length: 0\r\n"), "HTTP/1.1 200");
  EXPECT_EQ(answer_to("GET / HTTP/1.1\r\nHost : 127.0.0.1\r\n\r\n"), "HTTP/1.1 400");
  EXPECT_EQ(answer_to("\x16\x03\x01\r\n\r\n"), "HTTP/1.1 400");
}

TEST_F(WebProgramUnderLoad, DelaysOnlyWrongTokens) {
  std::list<Page> guessing;
  for (int i = 0; i < 11; ++i) {
    Page& page = guessing.emplace_back(open_page());
    say(page, wrong);
    say(page, command);
    const std::string heard = hear(page, "$web/refused");
    EXPECT_EQ(heard.find(R"("accepted":false)") == heard.npos, i >= 5) << i;
  }
  // The answer to the last guess is due in half a minute. The right token replaces it.
  say(guessing.back(), right);
  EXPECT_EQ(hear(guessing.back(), R"("accepted":)").find(R"("accepted":false)"), std::string::npos);
  const std::string output = slamgw::test::read_file(directory_ / "err");
  EXPECT_NE(output.find("6 wrong tokens from 127.0.0.1"), output.npos) << output;
  // The others still wait for their answers when the program ends.
  web_->send_signal(SIGTERM);
  EXPECT_EQ(web_->wait(), 0);
}

class WebProgramWithAViewer : public WebProgramUnderLoad {
 protected:
  void SetUp() override { start("ada operator 0123456789abcdef\nbob viewer fedcba9876543210\n"); }
  static constexpr const char* of_bob = R"({"topic":"$web/token","payload":"fedcba9876543210"})";
};

TEST_F(WebProgramWithAViewer, SendsNothingWithoutToken) {
  Page page = open_page();
  say(page, wrong);
  const std::string heard = hear(page, R"("accepted":false)");
  EXPECT_NE(heard.find(R"("needs_token":true)"), heard.npos) << heard;
  EXPECT_EQ(heard.find("$web/broker"), heard.npos) << heard;
  EXPECT_EQ(heard.find("prefix"), heard.npos) << heard;
  say(page, of_bob);
  EXPECT_NE(hear(page, "$web/broker").find(R"("now":1)"), heard.npos) << "the program's time";
  say(page, command);
  hear(page, "bob may watch, but not send commands");
}

TEST_F(WebProgramWithAViewer, ServesMetricsWithTokenOnly) {
  EXPECT_EQ(status_of("/metrics"), "HTTP/1.1 401");
  EXPECT_EQ(status_of("/metrics", "Authorization: Bearer guess\r\n"), "HTTP/1.1 401");
  EXPECT_EQ(status_of("/metrics", "Authorization: Bearer fedcba9876543210\r\n"), "HTTP/1.1 200");
  EXPECT_EQ(status_of_the_page(), "HTTP/1.1 200") << "the page's files are public";
}

}  // namespace
}  // namespace slamgw::web::test

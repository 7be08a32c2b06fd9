// SPDX-License-Identifier: Apache-2.0
// The control socket from a client's side: well-behaved, slow, silent, greedy and gone.
#include <sys/stat.h>
#include <unistd.h>
#include <nlohmann/json.hpp>

#include <boost/asio/connect.hpp>
#include <boost/asio/write.hpp>
#include <filesystem>

#include "tests/control/control_fixture.hpp"

namespace slamgw::test {
namespace {

using boost::asio::local::stream_protocol;
using boost::system::error_code;
using nlohmann::json;

/// A client on the server's own loop: never blocks.
class Client {
 public:
  Client(boost::asio::io_context& io, const std::string& path) : socket_(io) {
    socket_.connect(stream_protocol::endpoint(path));
    socket_.non_blocking(true);
  }

  void write(const std::string& text) {
    error_code ignored;
    boost::asio::write(socket_, boost::asio::buffer(text), ignored);
  }
  /// Reads the available input. Returns true once `line` holds a whole line.
  bool has_line() {
    take();
    const std::size_t end = input_.find('\n');
    if (end == std::string::npos) return false;
    line = json::parse(input_.substr(0, end));
    input_.erase(0, end + 1);
    return true;
  }
  bool is_ended() {
    take();
    return is_ended_;
  }
  void end_input() { socket_.shutdown(stream_protocol::socket::shutdown_send); }

  json line;

 private:
  void take() {
    char chunk[4096];
    error_code error;
    for (std::size_t size = 1; size > 0 && !error;) {
      size = socket_.read_some(boost::asio::buffer(chunk), error);
      input_.append(chunk, size);
    }
    if (error && error != boost::asio::error::would_block) is_ended_ = true;
  }

  stream_protocol::socket socket_;
  std::string input_;
  bool is_ended_ = false;
};

TraceEvent event_of(const std::string& robot, const std::string& type) {
  TraceEvent event;
  event.mesh = Mesh::thread;
  event.robot = robot;
  event.type = type;
  event.topic = "ntnu-slam/robot/" + robot + "/" + type;
  event.payload = to_bytes("hello");
  return event;
}

class ControlServerIo : public ControlTest {
 protected:
  json ask(Client& client, const std::string& request) {
    client.write(request + "\n");
    EXPECT_TRUE(wait_until([&] { return client.has_line(); })) << request;
    return client.line;
  }
};

TEST_F(ControlServerIo, AnswersSeveralClientsSeveralTimes) {
  start();
  handler.robots_answer.push_back({{"id", "r1"}});
  Client one(io, path);
  Client two(io, path);
  for (Client* client : {&one, &two, &one}) {
    EXPECT_EQ(ask(*client, R"({"command": "status"})")["result"]["version"], "1.2.3");
    EXPECT_EQ(ask(*client, R"({"command": "robots"})")["result"][0]["id"], "r1");
  }
}

TEST_F(ControlServerIo, AnswersPipelinedRequestsInOrder) {
  start();
  Client client(io, path);
  client.write("{\"command\": \"status\"}\n{\"command\": \"robots\"}\nnonsense\n");
  client.end_input();
  ASSERT_TRUE(wait_until([&] { return client.has_line(); }));
  EXPECT_TRUE(client.line["result"].is_object());
  ASSERT_TRUE(wait_until([&] { return client.has_line(); }));
  EXPECT_TRUE(client.line["result"].is_array());
  ASSERT_TRUE(wait_until([&] { return client.has_line(); }));
  EXPECT_TRUE(client.line.contains("error"));
  EXPECT_TRUE(wait_until([&] { return client.is_ended(); }));
  EXPECT_EQ(counter("bad_requests"), 1U);
}

TEST_F(ControlServerIo, ReturnsOutcomeOfCommandWhenItIsKnown) {
  start();
  Client client(io, path);
  client.write(R"({"command": "send", "robot": "r", "type": "cmd", "payload_hex": "0A00ecff"})"
               "\n");
  ASSERT_TRUE(wait_until([&] { return handler.sent.size() == 1; }));
  EXPECT_EQ(handler.sent[0].robot, "r");
  EXPECT_EQ(handler.sent[0].payload, (Bytes{0x0a, 0x00, 0xec, 0xff}));
  handler.sent[0].done({{"outcome", "delivered"}});
  ASSERT_TRUE(wait_until([&] { return client.has_line(); }));
  EXPECT_EQ(client.line["result"]["outcome"], "delivered");
}

TEST_F(ControlServerIo, DropsOutcomeAfterClientOrServerHasGone) {
  start();
  const std::string request = R"({"command": "send", "robot": "r", "type": "t", "payload_hex": ""})"
                              "\n";
  auto gone = std::make_unique<Client>(io, path);
  gone->write(request);
  ASSERT_TRUE(wait_until([&] { return handler.sent.size() == 1; }));
  gone.reset();
  handler.sent[0].done({{"outcome", "delivered"}});
  Client next(io, path);
  next.write(request);
  ASSERT_TRUE(wait_until([&] { return handler.sent.size() == 2; }));
  server->stop();
  handler.sent[1].done({{"outcome", "delivered"}});
  EXPECT_TRUE(wait_until([&] { return next.is_ended(); }));
  EXPECT_FALSE(next.has_line());
}

TEST_F(ControlServerIo, DropsRequestOfClientThatHasGoneButNotOfOneThatHasOnlyEndedItsInput) {
  start();
  const auto command_for = [](const std::string& robot) {
    return R"({"command": "send", "type": "t", "payload_hex": "", "robot": ")" + robot + "\"}\n";
  };
  Client(io, path).write(command_for("gone"));  // closed before the loop runs
  Client waiting(io, path);
  waiting.write(command_for("waiting"));
  waiting.end_input();
  ASSERT_TRUE(wait_until([&] { return !handler.sent.empty(); }));
  EXPECT_EQ(handler.sent[0].robot, "waiting");
  EXPECT_EQ(counter("requests_dropped"), 1U);
  handler.sent[0].done({{"outcome", "delivered"}});
  ASSERT_TRUE(wait_until([&] { return waiting.has_line(); }));
  EXPECT_EQ(waiting.line["result"]["outcome"], "delivered");
}

TEST_F(ControlServerIo, SendsWatchersOnlyEventsThatMatchTheirFilter) {
  start();
  Client all(io, path);
  Client some(io, path);
  EXPECT_FALSE(server->has_watchers());
  EXPECT_EQ(ask(all, R"({"command": "watch"})")["result"], "watching");
  ask(some, R"({"command": "watch", "robot": "b", "type": "update"})");
  EXPECT_TRUE(server->has_watchers());
  server->publish(event_of("a", "update"));
  server->publish(event_of("b", "adv"));
  server->publish(event_of("b", "update"));
  for (const auto* topic : {"a/update", "b/adv", "b/update"}) {
    ASSERT_TRUE(wait_until([&] { return all.has_line(); }));
    EXPECT_EQ(all.line["event"]["topic"], std::string("ntnu-slam/robot/") + topic);
  }
  ASSERT_TRUE(wait_until([&] { return some.has_line(); }));
  EXPECT_EQ(some.line["event"]["type"], "update");
  EXPECT_EQ(some.line["event"]["text"], "hello");
  EXPECT_EQ(handler.watched, std::vector{true});
  EXPECT_FALSE(some.has_line());
}

TEST_F(ControlServerIo, NoticesDisconnectOfWatcher) {
  start();
  {
    Client client(io, path);
    ask(client, R"({"command": "watch"})");
  }
  EXPECT_TRUE(wait_until([&] { return !server->has_watchers(); }));
  EXPECT_EQ(handler.watched, (std::vector{true, false}));
}

TEST_F(ControlServerIo, ReportsLostEventsToSlowWatcherAndKeepsFastOnes) {
  start({.queued_bytes = 4096});
  Client slow(io, path);
  Client reader(io, path);
  ask(slow, R"({"command": "watch"})");
  ask(reader, R"({"command": "watch"})");
  // Each event reaches the reader before the next; only the slow client's kernel buffer fills.
  std::uint64_t published = 0;
  while (published < 100000 && counter("events_lost") < 5) {
    server->publish(event_of("r", "update"));
    ++published;
    ASSERT_TRUE(wait_until([&] { return reader.has_line(); }));
  }
  const std::uint64_t lost = counter("events_lost");
  EXPECT_EQ(lost, 5U);
  std::uint64_t seen = 0;
  while (!slow.line.contains("event") || slow.line["event"]["event"] != "lost") {
    ASSERT_TRUE(wait_until([&] { return slow.has_line(); }));
    seen += 1;
  }
  EXPECT_EQ(slow.line["event"]["lost"], lost);
  EXPECT_EQ(seen - 1 + lost, published) << "each event is sent or counted as lost";
  server->publish(event_of("r", "last"));
  EXPECT_TRUE(wait_until([&] { return slow.has_line() && slow.line["event"]["type"] == "last"; }));
}

TEST_F(ControlServerIo, DisconnectsWatcherThatSendsRequestsAndDoesNotRead) {
  start({.queued_bytes = 4096});
  handler.status_answer = {{"text", std::string(2000, 'x')}};
  Client stuck(io, path);
  ask(stuck, R"({"command": "watch"})");
  EXPECT_TRUE(wait_until([&] {
    stuck.write("{\"command\": \"status\"}\n");
    return counter("watchers_dropped") == 1;
  }));
}

TEST_F(ControlServerIo, DisconnectsSilentClientButNoWatcher) {
  start({.idle = std::chrono::milliseconds(20)});
  Client watcher(io, path);
  ask(watcher, R"({"command": "watch"})");
  Client silent(io, path);
  EXPECT_TRUE(wait_until([&] { return silent.is_ended(); }));
  EXPECT_TRUE(server->has_watchers());
  EXPECT_FALSE(watcher.is_ended());
}

TEST_F(ControlServerIo, RefusesTooLongLine) {
  start({.request_bytes = 1024});
  Client client(io, path);
  client.write(std::string(2000, 'x'));
  ASSERT_TRUE(wait_until([&] { return client.has_line(); }));
  EXPECT_EQ(client.line["error"], "the request is longer than 1024 bytes");
  EXPECT_TRUE(wait_until([&] { return client.is_ended(); }));
}

TEST_F(ControlServerIo, RefusesOneClientTooMany) {
  start({.clients = 1});
  auto first = std::make_unique<Client>(io, path);
  ask(*first, R"({"command": "status"})");
  Client second(io, path);
  ASSERT_TRUE(wait_until([&] { return second.has_line(); }));
  EXPECT_EQ(second.line["error"],
            "1 clients are connected, which is the limit: end some slam-gatewayctl commands first");
  EXPECT_EQ(counter("clients_refused"), 1U);
  first.reset();
  EXPECT_TRUE(wait_until([&] {
    Client third(io, path);
    third.write("{\"command\": \"status\"}\n");
    return wait_until([&] { return third.has_line(); }) && third.line.contains("result");
  }));
}

TEST_F(ControlServerIo, KeepsPlacesForRequestsBesideWatchers) {
  start();
  std::vector<std::unique_ptr<Client>> watchers;
  while (watchers.size() < ControlLimits{}.clients) {
    const auto& next = watchers.emplace_back(std::make_unique<Client>(io, path));
    if (!ask(*next, R"({"command": "watch"})").contains("result")) break;
  }
  EXPECT_EQ(watchers.size(), 25U);
  Client& refused = *watchers.back();
  EXPECT_EQ(refused.line["error"],
            "24 clients watch already, which is the limit: end a slam-gatewayctl watch, record or "
            "check first");
  EXPECT_EQ(counter("clients_refused"), 1U);
  EXPECT_TRUE(ask(refused, R"({"command": "status"})").contains("result"));
  watchers.front().reset();
  EXPECT_TRUE(wait_until([&] {
    return ask(refused, R"({"command": "watch"})").contains("result");
  })) << "a place is free again";
}

TEST_F(ControlServerIo, CreatesSocketForOwnerAndGroupAndRemovesIt) {
  path = directory / "new/deep/control.sock";
  start();
  struct stat status {};
  ASSERT_EQ(stat(path.c_str(), &status), 0);
  EXPECT_TRUE(S_ISSOCK(status.st_mode));
  EXPECT_EQ(status.st_mode & 0777, 0660U);
  EXPECT_EQ(status.st_uid, geteuid());
  EXPECT_EQ(status.st_gid, getegid());
  server.reset();
  EXPECT_FALSE(std::filesystem::exists(path));
}

TEST_F(ControlServerIo, ReplacesSocketOfDeadDaemonButNotOfRunningOne) {
  { stream_protocol::acceptor dead(io, stream_protocol::endpoint(path)); }
  ASSERT_TRUE(std::filesystem::exists(path));
  start();
  ControlServer second(io, path, handler);
  try {
    second.start();
    FAIL() << "replaced the socket of a running daemon";
  } catch (const std::runtime_error& error) {
    EXPECT_EQ(error.what(), "control socket " + path +
                                ": another slam-gatewayd answers there; see control.socket");
  }
  second.stop();
  Client client(io, path);
  EXPECT_TRUE(ask(client, R"({"command": "status"})").contains("result"));
}

TEST_F(ControlServerIo, KeepsRegularFileAtSocketPath) {
  write_file(path, "precious");
  make_server();
  EXPECT_THROW(server->start(), std::runtime_error);
  server.reset();
  EXPECT_EQ(read_file(path), "precious");
}

}  // namespace
}  // namespace slamgw::test

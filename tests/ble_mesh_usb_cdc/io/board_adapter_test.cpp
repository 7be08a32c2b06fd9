// SPDX-License-Identifier: Apache-2.0
// The adapter over a real pseudo-terminal with a FakeBoard at its other end: first start, unplug
// and replug, and the file with the keys.
#include "adapters/ble_mesh_usb_cdc/io/board_adapter.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include <boost/asio/buffer.hpp>
#include <boost/asio/posix/stream_descriptor.hpp>
#include <boost/asio/write.hpp>
#include <filesystem>
#include <fstream>
#include <functional>
#include <set>

#include "adapters/ble_mesh_usb_cdc/io/cobs_adapter.hpp"
#include "tests/ble_mesh_usb_cdc/event_log.hpp"
#include "tests/ble_mesh_usb_cdc/fake_board.hpp"
#include "tests/ble_mesh_usb_cdc/hex.hpp"
#include "tests/ble_mesh_usb_cdc/io/slow_port.hpp"
#include "tests/support/memory_session_store.hpp"

namespace slamgw::ble {
namespace {

namespace asio = boost::asio;
namespace fs = std::filesystem;
using namespace std::chrono_literals;

/// A pseudo-terminal linked at `path`; octets written there reach `board`.
class PluggedBoard {
 public:
  PluggedBoard(asio::io_context& io, fs::path path, FakeBoard& board)
      : path_(std::move(path)), board_(board), master_(io, open_master()) {
    fs::create_symlink(::ptsname(master_.native_handle()), path_);
    read();
  }
  ~PluggedBoard() { fs::remove(path_); }

  void say(const Bytes& bytes) { asio::write(master_, asio::buffer(bytes)); }

 private:
  static int open_master() {
    const int master = ::posix_openpt(O_RDWR | O_NOCTTY);
    ::grantpt(master);
    ::unlockpt(master);
    return master;
  }

  void read() {
    master_.async_read_some(asio::buffer(buffer_), [this](auto error, std::size_t count) {
      if (error == asio::error::operation_aborted) return;
      if (error) return poll();  // the other end is not open
      const Bytes answer = board_.on_bytes(ByteView(buffer_).first(count));
      if (!answer.empty()) say(answer);
      read();
    });
  }

  void poll() {
    timer_.expires_after(5ms);
    timer_.async_wait([this](auto error) {
      if (!error) read();
    });
  }

  fs::path path_;
  FakeBoard& board_;
  asio::posix::stream_descriptor master_;
  asio::steady_timer timer_{master_.get_executor()};
  std::array<std::uint8_t, 512> buffer_{};
};

class Listener : public MeshListener, public EventLog {
 public:
  void on_mesh_event(MeshEvent event) override {
    const bool is_outcome = std::holds_alternative<CommandOutcome>(event);
    events.push_back(std::move(event));
    if (is_outcome && on_outcome) on_outcome();
  }
  std::function<void()> on_outcome;
};

class BoardAdapterTest : public ::testing::Test {
 protected:
  BoardAdapterTest() {
    std::string name = fs::temp_directory_path() / "slamgw-ble-XXXXXX";
    directory = ::mkdtemp(name.data());
    settings.device = directory / "tty";
    make_adapter();
  }
  ~BoardAdapterTest() override {
    adapter->stop();
    plugged.reset();
    io.poll();
    fs::remove_all(directory);
  }

  void make_adapter() {
    adapter = std::make_unique<BoardAdapter>(io, settings, TopicScheme("ntnu-slam", "gw"), names,
                                             directory.string(), sessions, listener);
  }
  void plug() { plugged.emplace(io, directory / "tty", board); }
  /// Runs the loop until `condition` is true; false after a limit that only a failure reaches.
  bool eventually(const std::function<bool()>& condition) {
    const auto limit = std::chrono::steady_clock::now() + 20s;
    while (!condition() && std::chrono::steady_clock::now() < limit) {
      io.restart();
      io.run_one_for(20ms);
    }
    return condition();
  }
  std::string mesh_file() const {
    std::ifstream file(directory / "mesh.json");
    return {std::istreambuf_iterator<char>(file), {}};
  }

  asio::io_context io;
  test::MemorySessionStore sessions;
  fs::path directory;
  Settings settings;
  RobotNames names;
  FakeBoard board;
  Listener listener;
  std::unique_ptr<BoardAdapter> adapter;
  std::optional<PluggedBoard> plugged;
};

TEST_F(BoardAdapterTest, BringsAFreshBoardUpAndCarriesAMessageBothWays) {
  plug();
  adapter->start();
  ASSERT_TRUE(eventually([&] { return listener.is_up(); }));
  EXPECT_EQ(fs::status(directory / "mesh.json").permissions(),
            fs::perms::owner_read | fs::perms::owner_write);
  EXPECT_NE(mesh_file().find(to_hex(board.subnets.at(0).second)), std::string::npos);

  plugged->say(board.message(0x0100, hex("c9 59 00 0a 00 ec ff"), 0xc003));
  ASSERT_TRUE(eventually([&] { return !listener.all<Report>().empty(); }));
  const Report report = listener.all<Report>()[0];
  EXPECT_EQ(report.topic, "ntnu-slam/robot/ble-0100/update");
  adapter->on_receipt(report.receipt.id, ReceiptOutcome::safe);
  ASSERT_TRUE(eventually([&] { return board.sent.size() == 1; }));
  EXPECT_EQ(to_hex(board.sent[0].payload), "cc590000");

  adapter->on_broker_message(
      {"ble-0100",
       {"ntnu-slam/server/ble-0100/cmd", hex("0a 00 ec ff"), Qos::at_least_once, false},
       CommandId{5}});
  ASSERT_TRUE(eventually([&] { return board.sent.size() == 2; }));
  plugged->say(board.message(0x0100, hex("d0 59 00 00")));
  ASSERT_TRUE(eventually([&] { return !listener.all<CommandOutcome>().empty(); }));
  EXPECT_EQ(listener.all<CommandOutcome>()[0].id, CommandId{5});
}

TEST_F(BoardAdapterTest, SurvivesUnplugAndReplug) {
  plug();
  adapter->start();
  ASSERT_TRUE(eventually([&] { return listener.is_up(); }));
  for (int round = 0; round < 2; ++round) {
    plugged.reset();
    ASSERT_TRUE(eventually([&] { return !listener.is_up(); }));
    plug();
    ASSERT_TRUE(eventually([&] { return listener.is_up(); }));
  }
  EXPECT_EQ(board.subnets.size(), 1u);
}

TEST_F(BoardAdapterTest, KeepsTryingMissingDevice) {
  adapter->start();
  ASSERT_TRUE(eventually([&] { return listener.all<LinkChange>().size() == 1; }));
  std::ofstream(directory / "tty") << "not a terminal";  // the next attempts fail in another way
  ASSERT_TRUE(eventually([&] { return listener.all<LinkChange>().size() == 2; }));
  fs::remove(directory / "tty");
  plug();
  EXPECT_TRUE(eventually([&] { return listener.is_up(); }));
}

TEST_F(BoardAdapterTest, GivesAReplacementBoardTheStoredKeys) {
  plug();
  adapter->start();
  ASSERT_TRUE(eventually([&] { return listener.is_up(); }));
  const Bytes net_key = board.subnets.at(0).second;
  adapter->stop();
  plugged.reset();
  io.poll();
  listener.events.clear();
  board = FakeBoard();
  make_adapter();
  plug();
  adapter->start();
  ASSERT_TRUE(eventually([&] { return listener.is_up(); }));
  EXPECT_EQ(board.subnets.at(0).second, net_key);
}

TEST_F(BoardAdapterTest, StaysOffWithADamagedKeyFileAndKeepsIt) {
  std::ofstream(directory / "mesh.json") << "{\"version\": 2, \"net_";
  make_adapter();
  plug();
  adapter->start();
  EXPECT_TRUE(listener.has_notice((directory / "mesh.json").string()));
  ASSERT_EQ(listener.all<LinkChange>().size(), 1u);
  EXPECT_FALSE(listener.is_up());
  io.poll();
  EXPECT_TRUE(board.commands.empty());
  EXPECT_EQ(mesh_file(), "{\"version\": 2, \"net_");
}

TEST_F(BoardAdapterTest, StaysOffWhenTheKeyFileCannotBeRead) {
  fs::create_directory(directory / "mesh.json");
  make_adapter();
  plug();
  adapter->start();
  EXPECT_TRUE(listener.has_notice("can't be read (Is a directory): the BLE mesh stays off"));
  EXPECT_FALSE(listener.is_up());
}

TEST_F(BoardAdapterTest, StaysOffWithTheAddressOfARobot) {
  NodeDatabase database;
  Node& node = database.nodes.emplace_back();
  node.address = settings.address;
  node.state = NodeState::configured;
  ASSERT_EQ(MeshFile(directory.string()).write(database), "");
  make_adapter();
  plug();
  adapter->start();
  EXPECT_TRUE(listener.has_notice("ble_mesh.address 0x0001 is a robot's"));
  io.poll();
  EXPECT_TRUE(board.commands.empty());
}

TEST_F(BoardAdapterTest, StaysOffWhenMeshFileContradictsItsAddress) {
  NodeDatabase guest;
  guest.guest_address = 2;
  ASSERT_EQ(MeshFile(directory.string()).write(guest), "");
  make_adapter();
  adapter->start();
  EXPECT_TRUE(listener.has_notice("ble_mesh.address must be 0x0002"));
  NodeDatabase first;
  first.gateways = {settings.address};
  ASSERT_EQ(MeshFile(directory.string()).write(first), "");
  make_adapter();
  adapter->start();
  EXPECT_TRUE(listener.has_notice("was given to another gateway of this mesh"));
}

TEST_F(BoardAdapterTest, AKeyFileIsNeverReplaced) {
  const MeshFile file(directory.string());
  EXPECT_EQ(file.write({}, /*is_new=*/true), "");
  const std::string before = mesh_file();
  NodeDatabase other;
  other.keys.net_key.fill(9);
  EXPECT_NE(file.write(other, /*is_new=*/true), "");
  EXPECT_EQ(mesh_file(), before);
  EXPECT_FALSE(fs::exists(directory / "mesh.json.new"));
}

TEST_F(BoardAdapterTest, ReportsUnstorableKeysAndDoesNotConfigureBoard) {
  settings.device = directory / "tty";
  adapter =
      std::make_unique<BoardAdapter>(io, settings, TopicScheme("ntnu-slam", "gw"), RobotNames(),
                                     (directory / "missing").string(), sessions, listener);
  plug();
  adapter->start();
  ASSERT_TRUE(eventually([&] { return listener.has_notice("can't be stored"); }));
  EXPECT_TRUE(board.subnets.empty());
}

TEST_F(BoardAdapterTest, PublishesPositionsFromStreamingBoard) {
  settings.protocol = Protocol::cobs;
  settings.robot_id = "nr1";
  CobsAdapter streams(io, settings, TopicScheme("ntnu-slam", "gw"), names, listener);
  plug();
  streams.start();
  ASSERT_TRUE(eventually([&] { return listener.is_up(); }));
  plugged->say(hex("00 02 0a 03 ec ff 01 00"));
  ASSERT_TRUE(eventually([&] { return !listener.all<Report>().empty(); }));
  EXPECT_EQ(listener.all<Report>()[0].topic, "ntnu-slam/robot/nr1/update");
  EXPECT_TRUE(board.commands.empty()) << "a streaming board gets no commands";
  streams.stop();
}

TEST_F(BoardAdapterTest, StopDoesNotWaitForABoardThatTakesNoData) {
  const auto gates = std::make_shared<Gates>();
  adapter = std::make_unique<BoardAdapter>(io, settings, TopicScheme("ntnu-slam", "gw"),
                                           RobotNames(), directory.string(), sessions, listener,
                                           open_slowly(settings, gates));
  plug();
  adapter->start();
  ASSERT_TRUE(eventually([&] { return listener.is_up(); }));
  gates->closing.shut();
  adapter->stop();
  EXPECT_TRUE(gates->closing.has_waiting_call()) << "stop() returned first";
  adapter.reset();
  gates->closing.open();
  make_adapter();
}

TEST_F(BoardAdapterTest, ReportsOutcomesOfCommandsThatCrashInterrupted) {
  const Now now = read_clocks();
  sessions.sessions["nr1"] = encode_open_commands({{"cmd", now.mono - 2s, true}}, now);
  sessions.sessions["nr2"] = encode_open_commands({{"x", now.mono - 1s, false}}, now);
  adapter->start();
  const auto outcomes = listener.all<CommandOutcome>();
  ASSERT_EQ(outcomes.size(), 2u);
  EXPECT_EQ(outcomes[0].robot, "nr1");
  EXPECT_EQ(outcomes[0].id, CommandId::none);
  EXPECT_EQ(outcomes[0].result, CommandResult::timeout);
  EXPECT_GE(outcomes[0].after, 2s - 2ms);
  EXPECT_EQ(outcomes[1].result, CommandResult::refused);
  EXPECT_NE(outcomes[1].why.find("before it was sent"), std::string::npos);
  EXPECT_TRUE(sessions.sessions.empty());
  adapter->stop();
  make_adapter();
  adapter->start();
  EXPECT_EQ(listener.all<CommandOutcome>().size(), 2u) << "once";
}

/// The core may call back when it gets an outcome.
TEST_F(BoardAdapterTest, ReportsInterruptedCommandsToListenerThatCallsBack) {
  const Now now = read_clocks();
  sessions.sessions["nr1"] =
      encode_open_commands({{"run", now.mono - 2s, true}, {"cmd", now.mono - 1s, true}}, now);
  sessions.sessions["nr2"] = encode_open_commands({{"x", now.mono - 1s, false}}, now);
  listener.on_outcome = [&] { adapter->trace(false); };
  adapter->start();
  const auto outcomes = listener.all<CommandOutcome>();
  ASSERT_EQ(outcomes.size(), 3u);
  EXPECT_EQ(outcomes[1].type, "cmd");
  EXPECT_TRUE(sessions.sessions.empty());
}

TEST_F(BoardAdapterTest, KeepsOpenCommandsOnDiskUntilTheirOutcome) {
  names = RobotNames({{"nr1", 0x0100, {}}});
  make_adapter();
  plug();
  adapter->start();
  ASSERT_TRUE(eventually([&] { return listener.is_up(); }));
  const auto kept = [&] { return decode_open_commands(sessions.sessions["nr1"], read_clocks()); };
  for (std::uint64_t id = 1; id <= 2; ++id)
    adapter->on_broker_message(
        {"nr1", {"ntnu-slam/server/nr1/x", {1, 2}, Qos::at_least_once, false}, CommandId{id}});
  ASSERT_TRUE(eventually([&] { return kept().size() == 2; }));
  EXPECT_TRUE(kept()[0].is_sent);
  EXPECT_FALSE(kept()[1].is_sent);
  plugged->say(board.message(0x0100, hex("c8 59 00 00")));
  ASSERT_TRUE(eventually([&] { return kept().size() == 1 && kept()[0].is_sent; }));
  adapter->stop_listening();
  adapter->stop();
  EXPECT_TRUE(kept().empty());
  EXPECT_EQ(listener.all<CommandOutcome>().size(), 2u);
}

/// A robot drops a TID that it saw within 6 s, but answers it. Four starts that draw the same TID
/// are one case in 16 million.
TEST_F(BoardAdapterTest, DoesNotBeginWithTheSameTidAfterARestart) {
  names = RobotNames({{"nr1", 0x0100, {}}});
  std::set<Bytes> commands;
  for (std::uint64_t start = 1; start <= 4; ++start) {
    adapter->stop();
    make_adapter();
    listener.events.clear();
    plug();
    adapter->start();
    ASSERT_TRUE(eventually([&] { return listener.is_up(); }));
    adapter->on_broker_message(
        {"nr1", {"ntnu-slam/server/nr1/run", {1}, Qos::at_least_once, false}, CommandId{start}});
    ASSERT_TRUE(eventually([&] { return !board.sent.empty(); }));
    commands.insert(board.sent.back().payload);
    plugged.reset();
    board.sent.clear();
  }
  EXPECT_GT(commands.size(), 1u);
}

TEST_F(BoardAdapterTest, ReturnsUnsentCommandsOfGivenUpRobot) {
  names = RobotNames({{"nr1", 0x0100, {}}});
  make_adapter();
  plug();
  adapter->start();
  ASSERT_TRUE(eventually([&] { return listener.is_up(); }));
  for (std::uint64_t id = 1; id <= 2; ++id)
    adapter->on_broker_message(
        {"nr1", {"ntnu-slam/server/nr1/x", {1, 2}, Qos::at_least_once, false}, CommandId{id}});
  const auto waiting = adapter->give_up("nr1");
  ASSERT_EQ(waiting.size(), 1u);
  EXPECT_EQ(waiting[0].command, CommandId{2});
  ASSERT_EQ(listener.all<CommandOutcome>().size(), 1u);
  EXPECT_EQ(listener.all<CommandOutcome>()[0].id, CommandId{1});
  EXPECT_TRUE(adapter->give_up("nr1").empty());
  EXPECT_TRUE(adapter->give_up("unknown").empty());
}

TEST_F(BoardAdapterTest, StoresNoPayloadOfCommands) {
  names = RobotNames({{"nr1", 0x0100, {}}});
  make_adapter();
  plug();
  adapter->start();
  ASSERT_TRUE(eventually([&] { return listener.is_up(); }));
  adapter->on_broker_message(
      {"nr1", {"ntnu-slam/server/nr1/x", Bytes(8, 'K'), Qos::at_least_once, false}, CommandId{1}});
  ASSERT_TRUE(eventually([&] { return sessions.sessions.contains("nr1"); }));
  EXPECT_EQ(as_text(sessions.sessions["nr1"]).find("KK"), std::string_view::npos);
}

TEST_F(BoardAdapterTest, ReportsNothingAfterStop) {
  plug();
  adapter->start();
  ASSERT_TRUE(eventually([&] { return listener.is_up(); }));
  adapter->stop();
  const std::size_t before = listener.events.size();
  plugged->say(board.message(0x0100, hex("c9 59 00 0a 00 ec ff"), 0xc003));
  adapter->on_broker_link(true);
  io.restart();
  io.poll();
  EXPECT_EQ(listener.events.size(), before);
}

}  // namespace
}  // namespace slamgw::ble

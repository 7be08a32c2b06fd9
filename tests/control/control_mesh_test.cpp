// SPDX-License-Identifier: Apache-2.0
// `slam-gatewayctl ble ...`: what it orders, what it shows, and how long it waits.
#include <filesystem>
#include <nlohmann/json.hpp>

#include <csignal>
#include <thread>

#include "tests/control/control_program_fixture.hpp"

namespace slamgw::test {
namespace {

template <class T>
T order_of(const FakeHandler& handler) {
  if (handler.orders.size() != 1 || !std::holds_alternative<T>(handler.orders[0].order)) {
    ADD_FAILURE() << handler.orders.size() << " orders, or one of another kind";
    return {};
  }
  return std::get<T>(handler.orders[0].order);
}

class ControlMeshIo : public ControlProgramIo {
 protected:
  Ended order(std::vector<std::string> arguments, OrderAnswer answer) {
    handler.orders.clear();
    handler.order_answer = std::move(answer);
    arguments.insert(arguments.begin(), "ble");
    return run(std::move(arguments));
  }
};

TEST_F(ControlMeshIo, ScansAndListsDevicesInReach) {
  start();
  const OrderAnswer found{
      R"([{"uuid":"736c616d000000000000000000000001","rssi_dbm":-56,"heard_s_ago":2,"state":"new",
           "robot":null},
          {"uuid":"736c616d000000000000000000000002","rssi_dbm":-101,"heard_s_ago":12,
           "state":"known","robot":"r2"}])",
      {}};
  const Ended result = order({"scan"}, found);
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(result.out,
            "UUID                              dBm SEEN STATE   ROBOT\n"
            "736c616d000000000000000000000001  -56   2s new     -\n"
            "736c616d000000000000000000000002 -101  12s known   r2\n");
  order_of<ScanOrder>(handler);
  EXPECT_EQ(json::parse(order({"scan", "--json"}, found).out).size(), 2u);
  EXPECT_EQ(order({"scan"}, {"[]", {}}).out, "no new robot is in reach\n");
}

TEST_F(ControlMeshIo, ProvisionsRobotUnderGivenName) {
  start();
  const Ended result =
      order({"provision", "736c616d000000000000000000000001", "--id", "r1"},
            {R"({"robot":"r1","uuid":"736c616d000000000000000000000001","address":"0x0100",
           "elements":1,"state":"provisioned","problem":"no answer to the key binding"})",
             {}});
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(result.out,
            "ROBOT            ADDRESS UUID                             STATE       \n"
            "r1               0x0100  736c616d000000000000000000000001 provisioned\n"
            "  no answer to the key binding\n");
  const auto ordered = order_of<ProvisionOrder>(handler);
  EXPECT_EQ(ordered.uuid, "736c616d000000000000000000000001");
  EXPECT_EQ(ordered.robot, "r1");
}

TEST_F(ControlMeshIo, ChangesAndShowsNodeConfiguration) {
  start();
  const OrderAnswer answer{R"({"robot":"r1","address":"0x0100","ttl":7,"models":[]})", {}};
  Ended result = order({"config", "r1"}, answer);
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_NE(result.out.find("TTL       7"), std::string::npos) << result.out;
  EXPECT_FALSE(order_of<NodeConfigOrder>(handler).is_change());
  result = order({"config", "r1", "--ttl", "7", "--relay", "off", "--transmit", "3x20"}, answer);
  EXPECT_EQ(result.status, 0) << result.err;
  auto wanted = order_of<NodeConfigOrder>(handler);
  EXPECT_EQ(wanted.ttl.value(), 7);
  EXPECT_EQ(wanted.relay.value(), false);
  EXPECT_EQ(wanted.transmit.value(), (Transmissions{3, 20}));
  order({"config", "r1", "--ttl", "default"}, answer);
  wanted = order_of<NodeConfigOrder>(handler);
  ASSERT_TRUE(wanted.ttl.has_value());
  EXPECT_FALSE(wanted.ttl->has_value());
  EXPECT_FALSE(wanted.relay.has_value());
  order({"config", "r1", "--publish", "pos_cmd=0xc00a"},
        {R"({"robot":"r1","warnings":["not heard"]})", {}});
  wanted = order_of<NodeConfigOrder>(handler);
  EXPECT_EQ(wanted.publish->model, "pos_cmd");
  EXPECT_EQ(wanted.publish->address, 0xc00a);
  result = order({"config", "r1", "--publish", "0x0002=default"},
                 {R"({"robot":"r1","warnings":["not heard"]})", {}});
  EXPECT_NE(result.out.find("  not heard\n"), std::string::npos) << result.out;
  EXPECT_FALSE(order_of<NodeConfigOrder>(handler).publish->address.has_value());
}

TEST_F(ControlMeshIo, WaitsForEndOfHearingMeasurement) {
  start();
  const auto child = launch({"ble", "topology", "--measure"});
  ASSERT_TRUE(wait_until([&] { return handler.orders.size() == 1; }));
  EXPECT_FALSE(order_of<MeasureHearingOrder>(handler).is_question);
  handler.orders[0].done({R"({"state":"running","robots":6,"seconds_left":75})", {}});
  ASSERT_TRUE(wait_until([&] { return handler.orders.size() == 2; }));
  EXPECT_TRUE(std::get<MeasureHearingOrder>(handler.orders[1].order).is_question);
  handler.orders[1].done({R"({"state":"done","rows":[],"silent":["r1"]})", {}});
  Ended result = finish(*child);
  EXPECT_EQ(result.status, 0);
  EXPECT_NE(result.err.find("6 robots"), std::string::npos) << result.err;
  EXPECT_NE(result.err.find("75 s"), std::string::npos) << result.err;
  EXPECT_EQ(result.out, "r1 left questions unanswered\n");
  result = order({"topology", "--measure"}, {R"({"state":"failed","why":"unplugged"})", {}});
  EXPECT_EQ(result.status, 1);
  EXPECT_NE(result.err.find("unplugged"), std::string::npos) << result.err;
}

TEST_F(ControlMeshIo, RefusesInvalidNodeConfiguration) {
  start();
  for (const auto& [option, word] :
       std::vector<std::pair<std::string, std::string>>{{"--ttl", "1"},
                                                        {"--ttl", "128"},
                                                        {"--ttl", "-1"},
                                                        {"--ttl", "x"},
                                                        {"--relay", "maybe"},
                                                        {"--subscribe", "0xbfff"},
                                                        {"--subscribe", "c001"},
                                                        {"--subscribe", "49153"},
                                                        {"--publish", "0xc00a"},
                                                        {"--publish", "min_com"},
                                                        {"--publish", "min_com=0"},
                                                        {"--publish", "min_com=10"},
                                                        {"--publish", "min_com=0x8001"},
                                                        {"--publish", "=0xc00a"},
                                                        {"--transmit", "3"},
                                                        {"--transmit", "9x20"},
                                                        {"--transmit", "3x25"}}) {
    const Ended result = order({"config", "r1", option + "=" + word}, {});
    EXPECT_EQ(result.status, 2) << option << word;
    EXPECT_NE(result.err.find(option), std::string::npos) << result.err;
  }
  EXPECT_TRUE(handler.orders.empty());
}

TEST_F(ControlMeshIo, PingsRobotGivenNumberOfTimes) {
  start();
  const Ended result = run({"ping", "r1", "-c", "2"});
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_NE(result.out.find("2 sent, 2 answered, 0 % lost"), std::string::npos) << result.out;
  EXPECT_EQ(run({"ping", "stranger"}).status, 1);
  EXPECT_EQ(run({"ping", "r1", "-c", "0"}).status, 2);
  EXPECT_EQ(json::parse(run({"ping", "r1", "--json"}).out)["answered"], true);
}

TEST_F(ControlMeshIo, SummarizesPingsAtCtrlC) {
  start();
  const auto child = launch({"ping", "r1", "-c", "1000"});
  ASSERT_TRUE(
      wait_until([&] { return read_file(file("out")).find("answered") != std::string::npos; }));
  child->send_signal(SIGINT);
  const Ended result = finish(*child);
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_NE(result.out.find(" answered, 0 % lost\n"), std::string::npos) << result.out;
}

TEST_F(ControlMeshIo, NamesHeardRobotsThatAreNotNodes) {
  start();
  handler.robots_answer = {{{"id", "r1"}, {"mesh", "ble"}, {"state", "online"}}};
  EXPECT_EQ(order({"nodes"}, {"[]", {}}).out,
            "no robot is in the mesh yet\n"
            "1 robot is heard that this gateway did not provision: r1\n");
  EXPECT_EQ(order({"scan"}, {"[]", {}}).out,
            "no new robot is in reach\n"
            "1 robot is heard that this gateway did not provision: r1\n");
}

TEST_F(ControlMeshIo, ShowsJoiningRobotsUntilTimeIsOver) {
  start();
  const auto child = launch({"ble", "permit-join", "--minutes", "3", "--id", "r1"});
  ASSERT_TRUE(wait_until([&] { return handler.orders.size() == 1; }));
  const auto permit = order_of<PermitJoinOrder>(handler);
  EXPECT_EQ(permit.time, std::chrono::minutes(3));
  EXPECT_EQ(permit.robot, "r1");
  handler.orders[0].done({R"({"seconds_left":180,"under_way":0,"last":7,"events":[]})", {}});
  ASSERT_TRUE(wait_until([&] { return handler.orders.size() == 2; }));
  EXPECT_EQ(std::get<JoinEventsOrder>(handler.orders[1].order).after, 7u);
  handler.orders[1].done(
      {R"({"seconds_left":100,"under_way":1,"last":8,"events":[{"number":8,"event":"joining",
           "uuid":"736c616d000000000000000000000001","robot":"r1","why":""}]})",
       {}});
  ASSERT_TRUE(wait_until([&] { return handler.orders.size() == 3; }));
  EXPECT_EQ(std::get<JoinEventsOrder>(handler.orders[2].order).after, 8u);
  handler.orders[2].done(
      {R"({"seconds_left":0,"under_way":0,"last":9,"events":[{"number":9,"event":"joined",
           "uuid":"736c616d000000000000000000000001","robot":"r1","why":""}]})",
       {}});
  const Ended result = finish(*child);
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(result.out,
            "new robots may join for 3 min 0 s; Ctrl-C ends this display only, --minutes 0 ends "
            "joining\n"
            "736c616d000000000000000000000001 joining    r1\n"
            "736c616d000000000000000000000001 joined     r1\n"
            "new robots may not join any more\n");
}

TEST_F(ControlMeshIo, FailsWhenNoRobotHasJoined) {
  start();
  const OrderAnswer none_joined{R"({"seconds_left":0,"under_way":0,"last":0,"events":[]})", {}};
  EXPECT_EQ(order({"permit-join"}, none_joined).status, 1);
  EXPECT_EQ(order_of<PermitJoinOrder>(handler).time, std::chrono::minutes(5));
  EXPECT_EQ(order({"permit-join", "--minutes", "0"}, none_joined).status, 0);
  EXPECT_EQ(order({"permit-join", "--minutes", "0", "--json"}, none_joined).out,
            "{\"event\":\"ended\"}\n");
  EXPECT_EQ(order({"permit-join", "--minutes", "2000"}, none_joined).status, 2);
}

TEST_F(ControlMeshIo, ListsAndRemovesNodes) {
  start();
  EXPECT_EQ(order({"nodes"}, {"[]", {}}).out, "no robot is in the mesh yet\n");
  order_of<NodesOrder>(handler);
  const Ended removed =
      order({"remove", "r1"},
            {R"({"robot":"r1","uuid":"736c","address":"0x0100","state":"configured"})", {}});
  EXPECT_EQ(removed.status, 0);
  EXPECT_EQ(
      removed.out,
      "r1 (0x0100) is out of the mesh; only this takes it in again: slam-gatewayctl ble "
      "provision 736c --id r1\n"
      "it may still have the mesh's keys; if strangers may have it, give the others new ones: "
      "slam-gatewayctl ble refresh-keys\n")
      << "its row would look as if it were still there";
  EXPECT_EQ(order_of<RemoveOrder>(handler).robot, "r1");
  EXPECT_FALSE(order_of<RemoveOrder>(handler).is_forced);
  EXPECT_EQ(order({"remove", "r1", "--force"}, {R"({"robot":"r1"})", {}}).status, 0);
  EXPECT_TRUE(order_of<RemoveOrder>(handler).is_forced);
}

TEST_F(ControlMeshIo, NamesReasonWhenOrderFails) {
  start();
  const Ended result = order({"remove", "r1"}, {{}, "no robot of this mesh is called r1"});
  EXPECT_EQ(result.status, 1);
  EXPECT_EQ(result.err, "slam-gatewayctl: no robot of this mesh is called r1\n");
}

TEST_F(ControlMeshIo, ImportsMeshFile) {
  start();
  write_file(directory / "mesh.json", "{\n  \"netKeys\": []\n}\n");
  const Ended result = order({"import", directory / "mesh.json"}, {R"({"nodes":3})", {}});
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(result.out, "imported: the mesh has 3 robots\n");
  EXPECT_EQ(order_of<ImportOrder>(handler).text, R"({"netKeys":[]})");
  EXPECT_NE(order({"import", directory / "none"}, {}).err.find("none can't be read: No such file"),
            std::string::npos);
  EXPECT_NE(order({"import", directory.path()}, {}).err.find(" is a directory; a file is needed"),
            std::string::npos);
  write_file(directory / "text", "no JSON");
  EXPECT_NE(order({"import", directory / "text"}, {}).err.find("is not JSON"), std::string::npos);
  EXPECT_TRUE(handler.orders.empty());
}

TEST_F(ControlMeshIo, ImportsLargeMeshIntoBusyDaemon) {
  start();
  json large{{"netKeys", json::array()}};
  large["nodes"] = std::string(800 * 1024, 'x');
  write_file(directory / "mesh.json", large.dump());
  const auto child = launch({"ble", "import", directory / "mesh.json"});
  std::this_thread::sleep_for(std::chrono::milliseconds(1500));  // the daemon does not read
  ASSERT_TRUE(wait_until([&] { return handler.orders.size() == 1; }));
  handler.orders[0].done({R"({"nodes":3})", {}});
  EXPECT_EQ(finish(*child).status, 0);
}

TEST_F(ControlMeshIo, ExportsIntoNewFileThatOnlyOwnerCanRead) {
  start();
  const std::string file = directory / "other.json";
  const Ended result =
      order({"export", file}, {R"({"address":"0x0002","mesh":"{\"k\":1}\n"})", {}});
  EXPECT_EQ(result.status, 0) << result.err;
  order_of<ExportOrder>(handler);
  EXPECT_EQ(read_file(file), "{\"k\":1}\n");
  EXPECT_EQ(std::filesystem::status(file).permissions(), std::filesystem::perms(0600));
  EXPECT_NE(result.out.find("set ble_mesh.address to 0x0002"), std::string::npos) << result.out;
  EXPECT_EQ(result.out.find("\"k\""), std::string::npos);
  const Ended again = order({"export", file}, {"{}", {}});
  EXPECT_EQ(again.status, 1);
  EXPECT_NE(again.err.find("File exists"), std::string::npos) << again.err;
  EXPECT_TRUE(handler.orders.empty());
  const std::string refused = directory / "refused.json";
  EXPECT_EQ(order({"export", refused}, {{}, "another gateway provisions this mesh"}).status, 1);
  EXPECT_FALSE(std::filesystem::exists(refused));
}

TEST_F(ControlMeshIo, ClearsBoardOnlyWithYesOption) {
  start();
  const Ended asked = order({"reset-board"}, {R"({"cleared":true})", {}});
  EXPECT_EQ(asked.status, 2);
  EXPECT_NE(asked.err.find("sequence numbers"), std::string::npos) << asked.err;
  EXPECT_EQ(asked.err.find("serial board"), std::string::npos) << "the radio may be BlueZ's";
  EXPECT_NE(asked.err.find("--yes"), std::string::npos);
  EXPECT_TRUE(handler.orders.empty());
  const Ended cleared = order({"reset-board", "--yes"}, {R"({"cleared":true})", {}});
  EXPECT_EQ(cleared.status, 0);
  EXPECT_NE(cleared.out.find("sends from the gateway's next address"), std::string::npos)
      << cleared.out;
  order_of<ResetBoardOrder>(handler);
}

TEST_F(ControlMeshIo, RefreshesKeysOnlyWithYesOption) {
  start();
  const std::string answer = R"({"step":"distributing","robots":3,"refreshed":2,"missing":[)"
                             R"({"robot":"r1","has_new_keys":false,"problem":"no answer"}]})";
  const Ended asked = order({"refresh-keys", "--leave-behind", "r1"}, {answer, {}});
  EXPECT_EQ(asked.status, 2);
  EXPECT_EQ(order({"refresh-keys", "--status=false"}, {answer, {}}).status, 2);
  EXPECT_NE(asked.err.find("--yes"), std::string::npos) << asked.err;
  EXPECT_TRUE(handler.orders.empty());
  const Ended begun = order(
      {"refresh-keys", "--leave-behind", "r1", "--leave-behind", "r2", "--yes"}, {answer, {}});
  EXPECT_EQ(begun.status, 0) << begun.err;
  EXPECT_EQ(begun.out,
            "key refresh: step 1 of 3, robots get the new keys; 2 of 3 robots have done it\n"
            "waits for r1: no answer\n");
  const RefreshKeysOrder first = order_of<RefreshKeysOrder>(handler);
  EXPECT_EQ(first.left_behind, (std::vector<std::string>{"r1", "r2"}));
  EXPECT_FALSE(first.leaves_silent || first.is_question);
  EXPECT_EQ(order({"refresh-keys", "--leave-behind-silent", "--yes"}, {answer, {}}).status, 0);
  EXPECT_TRUE(order_of<RefreshKeysOrder>(handler).leaves_silent);
}

TEST_F(ControlMeshIo, ShowsProgressOfKeyRefresh) {
  start();
  const Ended none = order({"refresh-keys", "--status"},
                           {R"({"step":"none","robots":3,"refreshed":3,"missing":[]})", {}});
  EXPECT_EQ(none.out, "the mesh's keys are not being refreshed\n");
  EXPECT_TRUE(order_of<RefreshKeysOrder>(handler).is_question);
  EXPECT_EQ(order({"refresh-keys", "--status", "--leave-behind", "r1"}, {"{}", {}}).status, 2);
}

TEST_F(ControlMeshIo, GivesOneJsonDocumentForEachOrder) {
  start();
  write_file(directory / "mesh.json", "{}");
  const std::vector<std::pair<std::vector<std::string>, std::string>> orders = {
      {{"scan"}, "[]"},
      {{"nodes"}, R"([{"robot":"r1"}])"},
      {{"provision", "00", "--id", "r1"}, R"({"robot":"r1"})"},
      {{"remove", "r1"}, R"({"robot":"r1"})"},
      {{"import", directory / "mesh.json"}, R"({"nodes":3})"},
      {{"refresh-keys", "--yes"}, R"({"step":"distributing"})"},
      {{"reset-board", "--yes"}, R"({"cleared":true})"}};
  for (auto [arguments, answer] : orders) {
    arguments.push_back("--json");
    const Ended result = order(arguments, {answer, {}});
    EXPECT_EQ(result.status, 0) << arguments[0] << result.err;
    EXPECT_EQ(json::parse(result.out, nullptr, false), json::parse(answer)) << arguments[0];
    EXPECT_EQ(result.err, "");
  }
}

TEST_F(ControlMeshIo, WaitsForAnswerBeyondIdleTimeout) {
  start({.idle = std::chrono::seconds(1)});  // slam-gatewayctl must have asked before
  const auto child = launch({"ble", "scan"});
  ASSERT_TRUE(wait_until([&] { return handler.orders.size() == 1; }));
  // Another silent client is disconnected, so the idle time has passed for this client, too.
  boost::asio::local::stream_protocol::socket silent(io);
  silent.connect(boost::asio::local::stream_protocol::endpoint(path));
  bool is_cut_off = false;
  char octet = 0;
  silent.async_read_some(
      boost::asio::buffer(&octet, 1),
      [&](boost::system::error_code error, std::size_t) { is_cut_off = !!error; });
  ASSERT_TRUE(wait_until([&] { return is_cut_off; }));
  handler.orders[0].done({"[]", {}});
  EXPECT_EQ(finish(*child).out, "no new robot is in reach\n");
}

}  // namespace
}  // namespace slamgw::test

// SPDX-License-Identifier: Apache-2.0
// A robot with an address on both meshes: a message that comes over both is published once, and
// commands go over the better mesh.
#include "tests/core/gateway_rig.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

class BothMeshes : public test::GatewayRig {
 protected:
  void SetUp() override { name(std::nullopt); }

  void name(std::optional<Mesh> prefer) {
    RobotName robot{"r1", 0x0100, "c1"};
    robot.prefer = prefer;
    gateway.set_names(RobotNames({robot}));
    reach[{Mesh::ble, "r1"}] = reach[{Mesh::thread, "r1"}] = Presence::online;
  }
  /// Returns how many messages are published for this one.
  std::size_t passed_up(Mesh mesh, const char* payload_hex, std::uint64_t receipt) {
    Report report = update_from("r1", *from_hex(payload_hex));
    report.mesh = mesh;
    report.receipt = Receipt{mesh, receipt};
    say(report);
    std::size_t ups = 0;
    while (auto action = gateway.next_action()) {
      ups += std::holds_alternative<PassUp>(*action) ? 1 : 0;
      if (const auto* fire = std::get_if<FireReceipt>(&*action)) fired.push_back(*fire);
    }
    return ups;
  }
  std::vector<FireReceipt> receipt_fires(Mesh mesh, std::uint64_t id, ReceiptOutcome outcome) {
    gateway.on_receipt(Receipt{mesh, id}, outcome, now);
    return drain<FireReceipt>();
  }
  void wait(Duration time) { now.mono += time; }
  std::optional<Mesh> carrier() {
    gateway.commands().on_robot_message(
        {"r1", {"ntnu-slam/server/r1/run", to_bytes("on"), Qos::at_least_once}}, now);
    const auto delivered = drain<DeliverToMesh>();
    if (delivered.empty()) return std::nullopt;
    last_command = delivered[0].message.command;
    return delivered[0].mesh;
  }
  void ends(Mesh mesh, CommandResult result, std::chrono::milliseconds after) {
    say(CommandOutcome{mesh, last_command, "r1", "run", result, after, ""});
    drain<Notice>();
  }

  CommandId last_command = CommandId::none;
  std::vector<FireReceipt> fired;
};

TEST_F(BothMeshes, PublishOneCopyAndAcknowledgeBothWhenItIsSafe) {
  EXPECT_EQ(passed_up(Mesh::ble, "01000200", 1), 1U);
  wait(200ms);
  EXPECT_EQ(passed_up(Mesh::thread, "01000200", 1), 0U);
  EXPECT_TRUE(fired.empty()) << "it is not safe yet";
  const auto copies = receipt_fires(Mesh::ble, 1, ReceiptOutcome::safe);
  ASSERT_EQ(copies.size(), 1U);
  EXPECT_EQ(copies[0].receipt, (Receipt{Mesh::thread, 1}));
  EXPECT_EQ(copies[0].outcome, ReceiptOutcome::safe);
}

TEST_F(BothMeshes, AcknowledgeACopyAtOnceWhenTheFirstIsSafe) {
  passed_up(Mesh::thread, "01000200", 5);
  receipt_fires(Mesh::thread, 5, ReceiptOutcome::safe);
  EXPECT_EQ(passed_up(Mesh::ble, "01000200", 9), 0U);
  ASSERT_EQ(fired.size(), 1U);
  EXPECT_EQ(fired[0].receipt, (Receipt{Mesh::ble, 9}));
}

TEST_F(BothMeshes, RefuseTheCopyOfARefusedMessageAndAcceptItsRepeat) {
  passed_up(Mesh::ble, "01000200", 1);
  passed_up(Mesh::thread, "01000200", 2);
  const auto copies = receipt_fires(Mesh::ble, 1, ReceiptOutcome::refused);
  ASSERT_EQ(copies.size(), 1U);
  EXPECT_EQ(copies[0].outcome, ReceiptOutcome::refused);
  EXPECT_EQ(passed_up(Mesh::thread, "01000200", 3), 1U);
}

TEST_F(BothMeshes, PassEqualMessagesOfARobotThatStandsStill) {
  for (std::uint64_t second = 0; second < 5; ++second) {
    EXPECT_EQ(passed_up(Mesh::ble, "01000200", 10 + second), 1U);
    wait(100ms);
    EXPECT_EQ(passed_up(Mesh::thread, "01000200", 20 + second), 0U);
    wait(900ms);
  }
}

TEST_F(BothMeshes, PassMessagesThatDifferComeLateOrComeOverTheSameMesh) {
  passed_up(Mesh::ble, "01000200", 1);
  EXPECT_EQ(passed_up(Mesh::thread, "01000300", 2), 1U) << "another position";
  EXPECT_EQ(passed_up(Mesh::ble, "01000200", 3), 1U) << "each mesh filters its own repeats";
  receipt_fires(Mesh::ble, 1, ReceiptOutcome::safe);
  receipt_fires(Mesh::ble, 3, ReceiptOutcome::safe);
  wait(CopyFilter::window + 1ms);
  EXPECT_EQ(passed_up(Mesh::thread, "01000200", 4), 1U);
}

TEST_F(BothMeshes, NeverAcknowledgeACopyOfAMessageWithoutAReceipt) {
  passed_up(Mesh::ble, "01000200", 0);
  EXPECT_EQ(passed_up(Mesh::thread, "01000200", 2), 1U);
}

TEST_F(BothMeshes, LeaveOtherRobotsAlone) {
  gateway.set_names(RobotNames());
  passed_up(Mesh::ble, "01000200", 1);
  EXPECT_EQ(passed_up(Mesh::thread, "01000200", 2), 1U);
}

TEST_F(BothMeshes, KeepABoundedNumberOfMessages) {
  for (std::uint64_t i = 0; i < 2 * CopyFilter::max_kept; ++i)
    passed_up(Mesh::ble, to_hex(ByteWriter{}.write_u16_le(1).write_u16_le(i & 0xff).take()).c_str(),
              i + 1);
  EXPECT_EQ(passed_up(Mesh::thread, "01000000", 1), 0U);
  EXPECT_EQ(passed_up(Mesh::thread, "01007f00", 2), 1U) << "there was no room for the first one";
}

TEST_F(BothMeshes, SendCommandsOverThePreferredMesh) {
  name(Mesh::thread);
  EXPECT_EQ(carrier(), Mesh::thread);
  reach[{Mesh::thread, "r1"}] = Presence::offline;
  EXPECT_EQ(carrier(), Mesh::ble);
  name(Mesh::ble);
  EXPECT_EQ(carrier(), Mesh::ble);
}

TEST_F(BothMeshes, SendNoCommandsOverAMeshWhereTheRobotIsSilent) {
  name(Mesh::thread);
  passed_up(Mesh::thread, "01000200", 1);
  passed_up(Mesh::ble, "01000300", 2);
  EXPECT_EQ(carrier(), Mesh::thread);
  wait(RobotDirectory::silent_after + 1ms);
  passed_up(Mesh::ble, "01000400", 3);
  EXPECT_EQ(carrier(), Mesh::ble) << "its session on Thread is still open";
  wait(RobotDirectory::silent_after + 1ms);
  EXPECT_EQ(carrier(), Mesh::thread) << "it is silent on both";
}

TEST_F(BothMeshes, SendCommandsOverTheMeshThatAnswersFaster) {
  EXPECT_EQ(carrier(), Mesh::ble) << "nothing is known yet";
  ends(Mesh::ble, CommandResult::delivered, 300ms);
  EXPECT_EQ(carrier(), Mesh::thread) << "the other one is tried";
  ends(Mesh::thread, CommandResult::delivered, 100ms);
  EXPECT_EQ(carrier(), Mesh::thread);
  ends(Mesh::thread, CommandResult::timeout, 29s);
  EXPECT_EQ(carrier(), Mesh::ble) << "a lost command counts much";
  wait(CarrierChoice::half_life * 10);
  ends(Mesh::ble, CommandResult::delivered, 300ms);
  EXPECT_EQ(carrier(), Mesh::thread) << "old losses are forgiven";
}

}  // namespace
}  // namespace slamgw

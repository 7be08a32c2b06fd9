// SPDX-License-Identifier: Apache-2.0
// The small parts: the bad radio of the Thread side, the command line, the summary.
#include <gtest/gtest.h>

#include "simulation/options.hpp"
#include "simulation/tally.hpp"
#include "simulation/thread/impairment.hpp"

namespace slamgw::sim {
namespace {

using std::chrono::milliseconds;

CommandLine parse(std::vector<const char*> arguments) {
  arguments.insert(arguments.begin(), "slam-gateway-sim");
  return parse_command_line(static_cast<int>(arguments.size()), arguments.data());
}

std::string help_of(const char* mesh) {
  testing::internal::CaptureStdout();
  parse({mesh, "--help"});
  return testing::internal::GetCapturedStdout();
}

TEST(CommandLine, HelpNamesValuesOfOptions) {
  for (const char* const mesh : {"thread", "ble"}) {
    const std::string help = help_of(mesh);
    for (const char* const words :
         {"--robot thesis|usual", "--world ring|room", "--payload full|positions|probe"})
      EXPECT_NE(help.find(words), help.npos) << help;
    EXPECT_EQ(help.find("->"), help.npos) << help;
  }
  EXPECT_NE(help_of("ble").find("--on-busy cancel|refuse"), std::string::npos);
}

TEST(CommandLine, ReportsWrongValueWithValidOnes) {
  testing::internal::CaptureStderr();
  const CommandLine line = parse({"thread", "--gateway", "h:1", "--world", "moon"});
  const std::string errors = testing::internal::GetCapturedStderr();
  ASSERT_TRUE(std::holds_alternative<int>(line));
  EXPECT_EQ(std::get<int>(line), 2);
  EXPECT_NE(errors.find("--world: 'moon' is not one of ring|room"), errors.npos) << errors;
}

TEST(CommandLine, AcceptsValuesOfItsHelp) {
  const CommandLine line = parse({"ble", "--tty", "t", "--world", "room", "--robot", "thesis",
                                  "--payload", "probe", "--on-busy", "refuse"});
  ASSERT_TRUE(std::holds_alternative<BleOptions>(line));
  const auto& options = std::get<BleOptions>(line);
  EXPECT_EQ(options.common.body.world, World::Shape::room);
  EXPECT_EQ(options.common.body.model, BodySettings::Model::thesis);
  EXPECT_EQ(options.common.body.payload, BodySettings::Payload::probe);
  EXPECT_EQ(options.on_busy, ble::OnBusy::refuse);
}

TEST(Impairment, LosesAndDoublesAtGivenRates) {
  sn::Impairment radio({0.2, 0.1, 0, milliseconds{5}}, Random(1, 1, Random::Use::uplink));
  int lost = 0;
  int doubled = 0;
  for (int i = 0; i < 10000; ++i) {
    const auto copies = radio.next_fate();
    if (copies.empty()) ++lost;
    if (copies.size() == 2) ++doubled;
    for (const Duration delay : copies) ASSERT_EQ(delay, milliseconds{5});
  }
  EXPECT_NEAR(lost, 2000, 150);
  EXPECT_NEAR(doubled, 800, 100);
}

TEST(Impairment, DelaysDatagramsAtGivenRate) {
  sn::Impairment radio({0, 0, 0.5, milliseconds{0}}, Random(1, 1, Random::Use::uplink));
  int held = 0;
  for (int i = 0; i < 1000; ++i) held += radio.next_fate().at(0) >= milliseconds{5} ? 1 : 0;
  EXPECT_NEAR(held, 500, 80);
}

/// Four transmissions on each of two hops: 1 - (1 - 0.5^4)^2 is lost.
TEST(Impairment, RepairsMostLossesOfEachHopWithDelayedRepeats) {
  const sn::Hop hop{0.5, milliseconds{4}};
  sn::Impairment radio({0, 0, 0, milliseconds{0}, {hop, hop}}, Random(1, 1, Random::Use::uplink));
  int lost = 0;
  unsigned repeats = 0;
  for (int i = 0; i < 10000; ++i) {
    const auto copies = radio.next_fate();
    repeats += radio.link_repeats();
    if (copies.empty()) ++lost;
    for (const Duration delay : copies) {
      ASSERT_GE(delay, milliseconds{4});
      ASSERT_LE(delay, milliseconds{48});
    }
  }
  EXPECT_NEAR(lost, 1211, 120);
  EXPECT_GT(repeats, 20000U);
}

TEST(CommandLine, HasTheDocumentedDefaults) {
  const auto thread = std::get<ThreadOptions>(parse({"thread", "--gateway", "[::1]:47193"}));
  EXPECT_EQ(thread.host, "::1");
  EXPECT_EQ(thread.port, "47193");
  EXPECT_EQ(thread.common.robots, 3U);
  EXPECT_EQ(thread.common.period(), milliseconds{200});
  EXPECT_EQ(thread.common.limit(), std::nullopt);
  EXPECT_EQ(thread.common.seed, 1U);
  EXPECT_EQ(thread.common.id_of(3), "robot3");
  EXPECT_EQ(thread.qos, 1);
  EXPECT_TRUE(thread.is_clean);
  EXPECT_EQ(thread.keep_alive_s, 60U);
  EXPECT_EQ(thread.sleep_s, 0U);
  const auto ble = std::get<BleOptions>(parse({"ble", "--tty", "/tmp/board"}));
  EXPECT_EQ(ble.ttys, std::vector<std::string>{"/tmp/board"});
  EXPECT_EQ(ble.hops, 1U);
  EXPECT_FALSE(ble.is_acknowledged);
  EXPECT_EQ(ble.on_busy, std::nullopt);
  EXPECT_EQ(ble.bearer_interval_ms, 0U);
  EXPECT_FALSE(ble.common.hop.is_given());
  EXPECT_EQ(ble.common.body.max_obstacles, 4U);
  EXPECT_TRUE(ble.common.body.has_stray);
}

TEST(CommandLine, AcceptsThesissRobotAndRadio) {
  const auto ble = std::get<BleOptions>(parse(
      {"ble",        "--tty",      "/tmp/board",     "--robot",    "thesis",  "--world",   "room",
       "--mirrored", "--payload",  "full",           "--no-stray", "--stand", "--on-busy", "refuse",
       "--hop-loss", "0.335,0.05", "--hop-delay-ms", "2",          "--hops",  "2"}));
  EXPECT_EQ(ble.common.body.model, BodySettings::Model::thesis);
  EXPECT_EQ(ble.common.body.world, World::Shape::room);
  EXPECT_EQ(ble.common.body.payload, BodySettings::Payload::full);
  EXPECT_TRUE(ble.common.body.is_mirrored);
  EXPECT_TRUE(ble.common.body.stands);
  EXPECT_FALSE(ble.common.body.has_stray);
  EXPECT_EQ(ble.on_busy, ble::OnBusy::refuse);
  EXPECT_EQ(ble.common.hop.loss_of(0), 0.335);
  EXPECT_EQ(ble.common.hop.loss_of(1), 0.05);
  EXPECT_EQ(ble.common.hop.delay_ms_of(1), 2);
}

TEST(CommandLine, AcceptsKindsOfThreadClients) {
  const auto thread = std::get<ThreadOptions>(
      parse({"thread", "--gateway", "host:1", "--sleep", "30", "--roam", "2.5", "--will-updates",
             "10", "--vanish", "0.5", "--no-clean", "--qos", "-1", "--keep-alive", "5"}));
  EXPECT_EQ(thread.sleep_s, 30U);
  EXPECT_EQ(thread.roam_s, 2.5);
  EXPECT_EQ(thread.will_updates_s, 10);
  EXPECT_EQ(thread.vanish, 0.5);
  EXPECT_FALSE(thread.is_clean);
  EXPECT_EQ(thread.qos, -1);
  EXPECT_EQ(thread.keep_alive_s, 5U);
}

TEST(CommandLine, ChoosesTheFirmware) {
  const auto usual = std::get<BleOptions>(parse({"ble", "--tty", "/tmp/board"}));
  EXPECT_EQ(usual.firmware->release, "3.1.0");
  const auto chosen = std::get<BleOptions>(
      parse({"ble", "--tty", "/tmp/board", "--firmware", "5.0.0", "--heartbeats"}));
  EXPECT_EQ(chosen.firmware->release, "5.0.0");
}

TEST(CommandLine, RefusesNumbersOutOfRange) {
  const std::pair<const char*, const char*> wrong[] = {{"--rate", "nan"},
                                                       {"--loss", "nan"},
                                                       {"--retry", "-nan"},
                                                       {"--hop-loss", "0.1,nan"},
                                                       {"--messages", "-1"},
                                                       {"--seed", "-1"},
                                                       {"--messages", " -1"},
                                                       {"--keep-alive", "-1"},
                                                       {"--rate", "0"},
                                                       {"--robots", "many"},
                                                       {"--sleep", "-18446744073709551615"}};
  for (const auto& [option, value] : wrong) {
    testing::internal::CaptureStderr();
    const CommandLine line = parse({"thread", "--gateway", "h:1", option, value});
    const std::string errors = testing::internal::GetCapturedStderr();
    EXPECT_TRUE(std::holds_alternative<int>(line)) << option << " " << value;
    EXPECT_EQ(errors.find(std::string("slam-gateway-sim: ") + option + ": "), 0U) << errors;
    EXPECT_NE(errors.find(" is not a number from "), errors.npos) << errors;
  }
  const auto line = parse({"thread", "--gateway", "h:1", "--seed", "18446744073709551615"});
  EXPECT_EQ(std::get<ThreadOptions>(line).common.seed, std::numeric_limits<std::uint64_t>::max());
}

TEST(CommandLine, ExitsWith2ForWrongArguments) {
  const std::vector<std::vector<const char*>> wrong = {
      {},
      {"ble"},
      {"thread", "--gateway", "host"},
      {"thread", "--gateway", "host:0"},
      {"thread", "--gateway", "::1:47193"},
      {"thread", "--gateway", "host:1", "--qos", "3"},
      {"thread", "--gateway", "host:1", "--qos", "-2"},
      {"thread", "--gateway", "host:1", "--vanish", "2"},
      {"thread", "--gateway", "host:1", "--sleep", "70000"},
      {"thread", "--gateway", "host:1", "--loss", "1.5"},
      {"thread", "--gateway", "host:1", "--id-prefix", "a/b"},
      {"thread", "--gateway", "host:1", "--id-prefix", "much-too-long-for-mqttsn"},
      {"ble", "--tty", "/tmp/board", "--unprovisioned", "--static-oob", "00"},
      {"ble", "--tty", "/tmp/board", "--uuid-prefix", "0"},
      {"ble", "--tty", "/tmp/board", "--uuid-prefix", "00112233445566778899aabbcc"},
      {"ble", "--tty", "/tmp/board", "--net-key", "00"},
      {"ble", "--tty", "/tmp/board", "--firmware", "4.0.0"},
      {"ble", "--tty", "/tmp/board", "--heartbeats"},
      {"ble", "--tty", "/tmp/board", "--qos", "1"},
  };
  for (const auto& arguments : wrong) {
    const CommandLine result = parse(arguments);
    ASSERT_TRUE(std::holds_alternative<int>(result));
    EXPECT_EQ(std::get<int>(result), 2);
  }
  EXPECT_EQ(std::get<int>(parse({"--help"})), 0);
}

TEST(Tally, IsPrintedAsOneJsonLine) {
  Tally life;
  life.wakes = 3;
  EXPECT_EQ(
      to_json({{"a", {}}, {"b", life}}),
      R"({"robots":{"a":{"sent":0,"acknowledged":0,"lost":0,"commands_received":0,"wakes":0},)"
      R"("b":{"sent":0,"acknowledged":0,"lost":0,"commands_received":0,"wakes":3}},)"
      R"("sent":0,"acknowledged":0,"lost":0,"commands_received":0,"wakes":3})");
  EXPECT_EQ(to_json({{"robot1", {5, 4, 1, 2}}, {"robot2", {1, 0, 0, 0}}}),
            R"({"robots":{"robot1":{"sent":5,"acknowledged":4,"lost":1,"commands_received":2},)"
            R"("robot2":{"sent":1,"acknowledged":0,"lost":0,"commands_received":0}},)"
            R"("sent":6,"acknowledged":4,"lost":1,"commands_received":2})");
}

}  // namespace
}  // namespace slamgw::sim

// SPDX-License-Identifier: Apache-2.0
// The flash of board and robots outlives the process.
#include "simulation/ble/state_file.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <system_error>

#include "tests/simulation/ble/mesh_host.hpp"

namespace slamgw::sim::ble {
namespace {

using std::chrono::seconds;

BleOptions with_storage(unsigned robots = 1) {
  BleOptions options = MeshHost::unprovisioned(robots);
  options.has_board_storage = true;
  return options;
}

TEST(StateFile, RestoresBoardAndRobots) {
  BleOptions options = with_storage(2);
  options.common.messages = 5;
  MeshHost first(options);
  first.adopt(0x0100);
  first.tell("03 a1 03 c0");
  first.ask("00 00 00 00 101112131415161718191a1b1c1d1e1f");
  first.ask("80 3d 00 01 00 00 59 00 06 00");
  first.ask("80 1b 00 01 04 c0 59 00 09 00");
  first.ask("03 00 01 01 00 00 10 04 00 02 59 00 06 00");
  first.ask("80 0d 07");
  first.ask("80 45 00 00 a0a1a2a3a4a5a6a7a8a9aaabacadaeaf");
  first.tell("13 93 00 00 a0a1a2a3a4a5a6a7a8a9aaabacadaeaf");
  first.tell("11 a2 404142434445464748494a4b4c4d4e4f");
  const std::string state = state_of(first.network());
  const auto nodes = nlohmann::json::parse(state)["nodes"];
  const auto published = nlohmann::json{0x0001, 0, 1, 4, 0, 2};  // retransmitted twice
  EXPECT_TRUE(std::ranges::any_of(nodes[0]["models"], [&](const auto& model) {
    return model["publication"] == published;
  })) << state;

  MeshHost second(options, state);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(second.network().nodes()[i].configuration(),
              first.network().nodes()[i].configuration());
  }
  for (const char* question : {"01 a0", "01 a8", "01 95", "03 9a 00 00", "03 a7 01 00",
                               "03 a7 20 00", "13 93 00 00 b0b1b2b3b4b5b6b7b8b9babbbcbdbebf"}) {
    EXPECT_EQ(second.tell(question), first.tell(question)) << question;
  }
  EXPECT_EQ(second.tell("03 a7 01 00"), "09 84 a7 00 01 00 03 01 03 c0");
  EXPECT_EQ(second.ask("80 18 00 01 59 00 06 00"),
            "80 19 00 00 01 01 00 00 10 04 5a 02 59 00 06 00");
  second.run(seconds{10});
  EXPECT_EQ(second.network().robots()[0].tally().sent, 5U);
  EXPECT_EQ(second.network().robots()[1].tally().sent, 0U);
}

TEST(StateFile, NeverGoesBackInSequenceNumbers) {
  MeshHost first(with_storage());
  first.adopt(0x0100);
  for (int i = 0; i < 20; ++i) first.ask("80 08 00");
  const std::string state = state_of(first.network());
  MeshHost second(with_storage(), state);
  EXPECT_GT(second.network().nodes()[0].next_sequence(),
            first.network().nodes()[0].next_sequence());
  first.send("80 08 00");
  const std::uint32_t used = first.network().board().flash().reserved_sequence;
  EXPECT_EQ(second.network().board().flash().reserved_sequence, used);
}

TEST(StateFile, RejectsInvalidStates) {
  Network network(with_storage());
  for (const char* text : {"{", "[]", "{\"board\":{}}", "{\"board\":7,\"nodes\":[]}"}) {
    EXPECT_THROW(restore_state(network, text), std::runtime_error) << text;
  }
  std::string state = state_of(network);
  std::string far = state;
  const std::string key(32, '0');
  far.replace(far.find("\"subnets\": []"), 13,
              "\"subnets\": [{\"handle\":8,\"index\":0,\"subnet\":0,\"key\":\"" + key + "\"}]");
  EXPECT_THROW(restore_state(network, far), std::runtime_error);
  state.replace(state.find("\"subnets\": []"), 13,
                "\"subnets\": [{\"handle\":0,\"index\":0,\"subnet\":0,\"key\":\"00\"}]");
  EXPECT_THROW(restore_state(network, state), std::runtime_error);
}

TEST(StateFile, IsReadableByItsOwnerOnlyAndReplacedAtomically) {
  std::string directory = "/tmp/slamgw-sim-XXXXXX";
  ASSERT_NE(mkdtemp(directory.data()), nullptr);
  const std::string path = directory + "/state";
  EXPECT_EQ(read_state(path), "");
  write_state(path, "old");
  write_state(path, "new");
  EXPECT_EQ(read_state(path), "new");
  EXPECT_EQ(std::filesystem::status(path).permissions(),
            std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  EXPECT_FALSE(std::filesystem::exists(path + ".new"));
  EXPECT_THROW(write_state(directory + "/none/state", ""), std::system_error);
  std::filesystem::remove_all(directory);
}

}  // namespace
}  // namespace slamgw::sim::ble

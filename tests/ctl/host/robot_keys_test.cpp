// SPDX-License-Identifier: Apache-2.0
// The file of robot keys is created, changed and read; no change is lost, a key is shown once.
#include "ctl/host/robot_keys.hpp"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <nlohmann/json.hpp>
#include <set>
#include <thread>
#include <vector>

#include "ctl/connection.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::ctl {
namespace {

using test::read_file;
using test::write_file;

class RobotKeysFile : public testing::Test {
 protected:
  RobotKeysFile() {
    write_file(directory_ / "gateway.json",
               R"({"mqttsn": {"dtls": {"keys_file": "keys.json"}},
                   "robots": [{"id": "tank", "mqttsn_client_id": "tank-client"}]})");
  }
  Installation installation() const { return Installation(directory_ / "gateway.json"); }
  nlohmann::ordered_json add(const std::string& robot) const {
    return change_keys(installation(), robot, true);
  }
  nlohmann::ordered_json remove(const std::string& robot) const {
    return change_keys(installation(), robot, false);
  }
  nlohmann::ordered_json list() const { return list_keys(installation()); }
  std::string file() const { return directory_ / "keys.json"; }
  unsigned mode() const {
    struct stat status {};
    stat(file().c_str(), &status);
    return status.st_mode & 07777U;
  }

  test::TempDir directory_;
};

TEST_F(RobotKeysFile, ShowsQrCodeOnTerminalOnly) {
  const auto answer = add("tank");
  const std::string finder = "    █▀▀▀▀▀█ ";  // ISO/IEC 18004: the upper corner, in the quiet zone
  EXPECT_NE(text_of_keys(answer, true).find(finder), std::string::npos);
  EXPECT_EQ(text_of_keys(answer).find("█"), std::string::npos);
  EXPECT_NE(text_of_keys(answer, true).find(qr_code("tank-client\n" + std::string(answer["key"]))),
            std::string::npos);
  EXPECT_EQ(qr_code(std::string(4000, 'x')), "") << "too long for a QR code";
}

TEST_F(RobotKeysFile, AddsDistinctKeyForEachRobot) {
  std::set<std::string> keys;
  for (const char* robot : {"r1", "r2", "tank"}) {
    const auto answer = add(robot);
    const std::string key = answer["key"];
    EXPECT_EQ(key.size(), 32U);
    EXPECT_EQ(key.find_first_not_of("0123456789abcdef"), std::string::npos);
    EXPECT_NE(text_of_keys(answer).find(key), std::string::npos);
    EXPECT_NE(read_file(file()).find(key), std::string::npos);
    keys.insert(key);
  }
  EXPECT_EQ(keys.size(), 3U);
  EXPECT_EQ(mode(), 0600U);
  const auto listed = list();
  EXPECT_EQ(text_of_keys(listed), "r1\nr2\ntank-client\n") << "keys are stored by client id";
  for (const std::string& key : keys)
    EXPECT_EQ(listed.dump().find(key), std::string::npos) << "names only";
  EXPECT_EQ(installation().parsed().config.robot_keys.size(), 3U);
  EXPECT_TRUE(installation().parsed().problems.empty());
}

TEST_F(RobotKeysFile, KeepsAKeyUntilItIsRemoved) {
  add("r1");
  const std::string before = read_file(file());
  EXPECT_THROW(add("r1"), Failure);
  EXPECT_EQ(read_file(file()), before);
  EXPECT_THROW(remove("r2"), Failure);
  remove("r1");
  EXPECT_EQ(text_of_keys(list()), "no robot has a key\n");
  EXPECT_THROW(add("no/level"), Failure);
}

TEST_F(RobotKeysFile, RemovesOnlyKeysOfTheNamedRobot) {
  add("r1");
  add("tank");
  write_file(directory_ / "gateway.json",
             R"({"mqttsn": {"dtls": {"keys_file": "keys.json"}},
                 "robots": [{"id": "r1", "mqttsn_client_id": "r1-client"},
                            {"id": "tank-client", "mqttsn_client_id": "boat-client"},
                            {"id": "tank", "mqttsn_client_id": "tank-client"}]})");
  add("r1");
  EXPECT_EQ(remove("r1")["identity"], "r1-client") << "the robot's own key comes first";
  EXPECT_EQ(remove("r1")["identity"], "r1");
  EXPECT_THROW(remove("r1"), Failure);
  EXPECT_THROW(remove("tank-client"), Failure) << "it is the key of another robot";
  EXPECT_EQ(text_of_keys(list()), "tank-client\n");
}

TEST_F(RobotKeysFile, KeepsAllKeysAddedConcurrently) {
  std::vector<std::thread> writers;
  for (int i = 0; i < 8; ++i) writers.emplace_back([&, i] { add("r" + std::to_string(i)); });
  for (std::thread& writer : writers) writer.join();
  EXPECT_EQ(list()["robots"].size(), 8U);
}

TEST_F(RobotKeysFile, IsNotChangedWhenOthersCanReadItOrItIsInvalid) {
  write_file(file(), "{}", 0640);
  EXPECT_THROW(add("r1"), Failure);
  EXPECT_EQ(read_file(file()), "{}");
  write_file(file(), R"({"r1": "secret)", 0600);
  chmod(file().c_str(), 0600);
  try {
    add("r2");
    ADD_FAILURE() << "overwrote an invalid file";
  } catch (const Failure& failure) {
    EXPECT_EQ(std::string(failure.what()).find("secret"), std::string::npos) << failure.what();
  }
}

TEST_F(RobotKeysFile, NamesSettingToAddWithoutKeysFile) {
  write_file(directory_ / "gateway.json", "{}");
  try {
    add("r1");
    ADD_FAILURE() << "added a key without a keys file";
  } catch (const Failure& failure) {
    EXPECT_NE(std::string(failure.what()).find("gateway.d/dtls.json"), std::string::npos);
  }
}

}  // namespace
}  // namespace slamgw::ctl

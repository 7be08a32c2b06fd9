// SPDX-License-Identifier: Apache-2.0
// The built slam-gatewayctl against a control server, for the tests of what it prints.
#pragma once

#include "tests/control/control_fixture.hpp"
#include "tests/support/child_process.hpp"

namespace slamgw::test {

using nlohmann::json;

struct Ended {
  int status = -1;
  std::string out;
  std::string err;
};

class ControlProgramIo : public ControlTest {
 protected:
  /// Starts slam-gatewayctl with these arguments after its --socket.
  std::unique_ptr<ChildProcess> launch(std::vector<std::string> arguments,
                                       std::vector<std::string> prefix = {}) {
    ++runs_;
    prefix.insert(prefix.end(), {SLAMGW_CTL, "--socket", path});
    prefix.insert(prefix.end(), arguments.begin(), arguments.end());
    return std::make_unique<ChildProcess>(prefix, file("out"), file("err"));
  }
  Ended finish(ChildProcess& child) {
    EXPECT_TRUE(wait_until([&] { return !child.is_running(); }));
    return {child.wait().value_or(-1), read_file(file("out")), read_file(file("err"))};
  }
  Ended run(std::vector<std::string> arguments, std::vector<std::string> prefix = {}) {
    return finish(*launch(std::move(arguments), std::move(prefix)));
  }
  /// `send` with the daemon's answer.
  Ended send(std::vector<std::string> arguments, const json& outcome) {
    handler.sent.clear();
    arguments.insert(arguments.begin(), "send");
    const auto child = launch(std::move(arguments));
    EXPECT_TRUE(wait_until([&] { return !handler.sent.empty() || !child->is_running(); }));
    if (!handler.sent.empty()) handler.sent[0].done(outcome);
    return finish(*child);
  }
  std::string file(const std::string& name) const {
    return directory / (name + std::to_string(runs_));
  }

  int runs_ = 0;
  const json delivered_ = {{"outcome", "delivered"}, {"after_ms", 12}, {"why", ""}};
};

}  // namespace slamgw::test

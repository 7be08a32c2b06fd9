// SPDX-License-Identifier: Apache-2.0
// A control server on a socket of its own with a handler that records requests, for the tests of
// both ends of the socket.
#pragma once

#include <gtest/gtest.h>

#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "daemon/control/control_server.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw::test {

class FakeHandler : public ControlHandler {
 public:
  struct Sent {
    std::string robot;
    std::string type;
    Bytes payload;
    std::function<void(nlohmann::json)> done;
  };

  nlohmann::json status_answer = {{"version", "1.2.3"}};
  nlohmann::json robots_answer = nlohmann::json::array();
  nlohmann::json fleet_answer = {{"gateway", "room-a"}, {"gateways", nlohmann::json::array()}};
  struct Ordered {
    BleOrder order;
    OrderDone done;
  };
  OrderAnswer reload_answer{R"({"in_force": "log"})", {}};
  std::vector<Sent> sent;
  std::vector<bool> watched;
  std::vector<std::string> who;  ///< the user of each order
  std::vector<std::string> forgotten;
  std::vector<Ordered> orders;
  struct StoreOrdered {
    StoreOrder order;
    OrderDone done;
  };
  std::vector<StoreOrdered> store_orders;
  std::deque<OrderAnswer> store_answers;    ///< given at once, one after the other
  std::optional<OrderAnswer> order_answer;  ///< given at once when set

  void on_request(const std::string& by, control::Request request, Answer answer) override {
    using namespace control;
    const OrderDone done = [answer](const OrderAnswer& ended) { answer(order_line(ended)); };
    std::visit(
        overloaded{
            [&](StatusRequest&) { answer(result_line(status_answer)); },
            [&](RobotsRequest& asked) { answer(result_line(robots(asked.robot))); },
            [&](FleetRequest&) { answer(result_line(fleet_answer)); },
            [&](MqttsnClientsRequest& asked) { done(mqttsn_clients(asked.robot)); },
            [&](ReloadRequest&) { done(reload(by)); },
            [&](ForgetRequest& order) { done(forget(by, order.robot)); },
            [&](SendRequest& command) {
              who.push_back(by);
              sent.push_back({command.robot, command.type, std::move(command.payload),
                              [answer](const auto& outcome) { answer(result_line(outcome)); }});
            },
            [&](PingRequest& asked) { ping(asked.robot, done); },
            [&](BleOrder& order) { manage_ble(by, std::move(order), done); },
            [&](StoreOrder& order) { manage_store(by, std::move(order), done); },
            [](WatchRequest&) { ADD_FAILURE() << "the server handles watch requests itself"; },
        },
        request);
  }
  nlohmann::json robots(const std::optional<std::string>& robot) {
    if (!robot) return robots_answer;
    nlohmann::json found = nlohmann::json::array();
    for (const auto& row : robots_answer)
      if (row["id"] == *robot) found.push_back(row);
    return found;
  }
  OrderAnswer mqttsn_clients(const std::optional<std::string>& robot) {
    if (robot == "stranger") return {{}, "stranger has no MQTT-SN session here"};
    return {nlohmann::json::array({{{"robot", robot.value_or("all")}}}).dump(), {}};
  }
  void on_watched(bool is_watched) override { watched.push_back(is_watched); }
  void ping(const std::string& robot, OrderDone done) {
    if (robot == "stranger") return done({{}, "no robot called stranger is known here"});
    done({nlohmann::json{{"robot", robot}, {"answered", true}}.dump(), {}});
  }
  void manage_ble(const std::string& by, BleOrder order, OrderDone done) {
    who.push_back(by);
    orders.push_back({std::move(order), done});
    if (order_answer) done(*order_answer);
  }
  OrderAnswer reload(const std::string& by) {
    who.push_back(by);
    return reload_answer;
  }
  OrderAnswer forget(const std::string& by, const std::string& robot) {
    who.push_back(by);
    forgotten.push_back(robot);
    if (robot == "online") return {{}, "online is online: switch it off first"};
    return {nlohmann::json{{"forgotten", robot}, {"was_known", robot == "old"}}.dump(), {}};
  }
  void manage_store(const std::string& by, StoreOrder order, OrderDone done) {
    who.push_back(by);
    store_orders.push_back({std::move(order), done});
    if (store_answers.empty()) return;
    done(store_answers.front());
    store_answers.pop_front();
  }
};

class ControlTest : public testing::Test {
 protected:
  bool wait_until(const std::function<bool()>& condition) { return eventually(io, condition); }
  std::uint64_t counter(std::string_view name) const {
    for (const Counter& each : server->counters())
      if (each.name == name) return each.value;
    return 0;
  }
  void make_server(ControlLimits limits = {}) {
    server.reset();
    server = std::make_unique<ControlServer>(io, path, handler, limits);
  }
  void start(ControlLimits limits = {}) {
    make_server(limits);
    server->start();
  }

  TempDir directory;
  std::string path = directory / "control.sock";
  boost::asio::io_context io;
  FakeHandler handler;
  std::unique_ptr<ControlServer> server;
};

}  // namespace slamgw::test

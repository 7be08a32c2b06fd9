// SPDX-License-Identifier: Apache-2.0
// The settings of one client on Thread, and the bounds and times of Nordic's client.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "simulation/time.hpp"

namespace slamgw::sim::sn {

constexpr std::chrono::seconds retransmission_interval{8};
constexpr unsigned transmissions = 3;        // the first and two repeats
constexpr std::size_t max_outstanding = 4;   // Nordic's queue; the specification has 1
constexpr std::size_t max_application = 25;  // the robots' FIFO of 512 bytes (thesis 6.2.2)
constexpr std::chrono::seconds search_time{5};
constexpr std::chrono::seconds goodbye_time{3};

struct ClientSettings {
  std::string client_id;
  std::string topic_prefix = "ntnu-slam";
  int qos = 1;                            ///< -1: on `predefined_id`, without ever connecting
  std::optional<std::uint64_t> messages;  ///< updates to send; nothing: no end
  Duration period = std::chrono::milliseconds{200};
  Duration start_delay{0};  ///< the client's random wait before SEARCHGW
  bool obeys = false;       ///< commands steer the robot
  bool hears = false;       ///< subscribes to the updates of all robots
  std::chrono::seconds keep_alive{60};
  bool is_clean = true;           ///< CleanSession of the CONNECT that begins a session
  std::chrono::seconds sleep{0};  ///< duration in DISCONNECT; 0: it never sleeps
  Duration will_interval{0};      ///< between changes of the will; 0: none
  bool resumes = false;           ///< resumes its session on DISCONNECT, unlike Nordic's client
  bool vanishes = false;          ///< ends without DISCONNECT
  Duration retry_interval = retransmission_interval;
  std::size_t outstanding = max_outstanding;
  bool is_recorded = false;         ///< leaves events
  std::uint16_t predefined_id = 0;  ///< of the topic `update`, for QoS -1
};

}  // namespace slamgw::sim::sn

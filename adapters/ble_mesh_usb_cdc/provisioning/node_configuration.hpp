// SPDX-License-Identifier: Apache-2.0
// The conversation with one node under its device key: its configuration, a step of the mesh's key
// refresh, its reset, or questions about it. A radio
// holds few device keys, so the key is added before and removed after it. Requests go out one
// after the other, each repeated until its answer comes. Called by NodeConversations.
#pragma once

#include <array>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/access/config_messages.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"

namespace slamgw::ble {

inline constexpr std::uint16_t nordic = 0x0059;
inline constexpr ModelId health_server{{}, 0x0002};
/// Robots have it and it takes STATUS; its server is the gateway.
inline constexpr ModelId sensor_update_client{nordic, 0x0006};
/// The models that publish: the clients of the thesis's models (5.2.1) and of Nordic's Simple
/// OnOff, and the health server.
inline constexpr std::array publishers{ModelId{nordic, 0x0004}, sensor_update_client,
                                       ModelId{nordic, 0x0008}, ModelId{nordic, 0x0001},
                                       health_server};

struct ModelElement {
  std::uint16_t element = 0;  ///< unicast address
  ModelId model;
};

/// One request under the node's device key, and how its answer is known.
struct ConfigurationStep {
  std::string what;  ///< for the operator
  Bytes request;     ///< access message
  Opcode answer = 0;
  bool has_status = true;                            ///< the answer's first octet is a status
  Bytes echoed_head = {};                            ///< what comes after the status
  Bytes echoed_tail = {};                            ///< what the answer ends with
  bool is_required = true;                           ///< without it the rest makes no sense
  std::uint8_t also_done = 0;                        ///< a status that means as much as success
  std::optional<ModelElement> lists_groups_of = {};  ///< its answer is this model's groups
  std::optional<ModelElement> about = {};            ///< of an inquiry: the model it asks of
  Bytes expected = {};        ///< not empty: the answer of a node that has done it
  bool is_sent_once = false;  ///< not repeated when it is not answered

  /// True also for an answer that says no.
  bool is_answered_by(const AccessMessage& message) const;
};

struct ConfigurationSettings {
  Key app_key{};
  std::uint16_t destination = 0x0001;  ///< of what the robot publishes: a gateway, or their group
  std::uint8_t ttl = 4;
  std::vector<std::uint16_t> groups;
  std::optional<std::uint16_t> relay_group = {};  ///< of the updates that are relayed to robots
  NodeWishes wishes = {};
  bool had_relay_group = false;  ///< the robot may hear in one
  RefreshState refresh = {};     ///< to `refresh` the node: the step, and the new keys
  std::vector<ConfigurationStep> questions = {};  ///< of a `survey`
};

/// A node's answer to one question of a ping, an inquiry or a survey.
struct NodeAnswer {
  Opcode opcode = 0;
  std::optional<ModelElement> about;
  Bytes params;
  Duration after{};     ///< since the question was sent first
  unsigned copies = 0;  ///< of the question that were sent
  std::optional<std::uint8_t> ttl;
  std::optional<std::int8_t> rssi_dbm;
};

class NodeConfiguration {
 public:
  /// `move`: only what it publishes to. `refresh`: a step of the key refresh. `ping` and `inquire`
  /// change nothing, `survey` heartbeats alone.
  enum class Purpose : std::uint8_t { configure, move, refresh, reset, ping, inquire, survey };
  enum class State : std::uint8_t { running, succeeded, failed };

  /// One request is given up after this long.
  static constexpr Duration step_time_limit = std::chrono::seconds{20};
  /// Of a ping or a survey.
  static constexpr Duration ping_time_limit = std::chrono::seconds{5};
  /// The pause before it is sent again, doubled each time: after 0.5 s, 1.5 s, 3.5 s ...; twice
  /// that when it is segmented, because the radio repeats the segments by itself.
  static constexpr Duration first_pause = std::chrono::milliseconds{500};
  /// The radio was still sending an earlier segmented message to this node.
  static constexpr Duration refused_pause = std::chrono::milliseconds{150};

  /// `radio` outlives it.
  NodeConfiguration(const Node& node, Purpose purpose, ConfigurationSettings settings,
                    Radio& radio);

  /// The radio has the device key, or has removed it, or does not take it.
  void on_key_used(const std::string& problem, TimePoint now);
  /// Sends the request under way when it is due, for the first time or again.
  void send_due(TimePoint now);
  /// True when it is an answer under this node's device key.
  bool on_message(const MessageReceived& message, TimePoint now);
  void on_send_refused(const std::string& why, TimePoint now);
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);

  /// Ended only when the radio has removed the device key.
  State state() const { return stage_ == Stage::ended ? result_ : State::running; }
  Purpose purpose() const { return purpose_; }
  RefreshStep refresh_step() const { return settings_.refresh.step; }
  std::uint16_t address() const { return address_; }
  /// Why it failed, or which requests the node refused; empty when all went well.
  const std::string& problem() const { return problem_; }
  /// Of a ping, an inquiry or a survey.
  const std::vector<NodeAnswer>& answers() const { return answers_; }

 private:
  enum class Stage : std::uint8_t { adding_key, talking, removing_key, ended };

  void begin_step(TimePoint now);
  bool keeps_answers() const {
    return purpose_ == Purpose::ping || purpose_ == Purpose::inquire || purpose_ == Purpose::survey;
  }
  Duration time_limit() const;
  std::vector<ConfigurationStep> plan(const Composition& composition) const;
  void keep(const ConfigurationStep& step, const MessageReceived& from, ByteView params,
            TimePoint now);
  void on_answer(const AccessMessage& message, TimePoint now);
  void add_problem(const std::string& problem);
  void finish(State result, std::string problem);

  Purpose purpose_;
  ConfigurationSettings settings_;
  std::uint16_t address_;
  Radio& radio_;
  Stage stage_ = Stage::adding_key;
  State result_ = State::succeeded;
  std::string problem_;
  std::deque<ConfigurationStep> steps_;  ///< front: the one under way
  TimePoint step_since_{};
  TimePoint send_at_{};
  Duration pause_{};     ///< before the next repeat
  unsigned copies_ = 0;  ///< of the request under way
  std::string last_refusal_;
  std::vector<NodeAnswer> answers_;
};

}  // namespace slamgw::ble

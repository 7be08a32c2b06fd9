// SPDX-License-Identifier: Apache-2.0
// The conversation with one node under its device key: its configuration, a step of the mesh's key
// refresh, its reset, or questions about it. A radio holds few device keys, so the key is added
// before the conversation and removed after it. Requests are sent one after the other, each
// repeated until its answer comes. Called by NodeConversations.
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
/// Robots have this model, which takes STATUS; the gateway is its server.
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

/// One request under the node's device key, and the marks of its answer.
struct ConfigurationStep {
  std::string what;  ///< for the operator
  Exchange exchange;
  Bytes request;                           ///< access message
  Bytes echoed_tail = {};                  ///< the last octets of the answer
  bool is_required = true;                 ///< without it, further steps make no sense
  std::uint8_t also_done = 0;              ///< a status that counts as success
  std::optional<ModelElement> about = {};  ///< the model that it concerns
  Bytes expected = {};                     ///< if not empty: the answer of a node that has obeyed
  bool is_sent_once = false;               ///< not repeated without an answer

  /// Returns true also for an answer that refuses the request.
  bool is_answered_by(const AccessMessage& message) const;
};

/// Returns the step with this request; parameters as for octets_of().
template <class... Values>
ConfigurationStep config_step(std::string what, const Exchange& exchange, const Values&... values) {
  return {.what = std::move(what),
          .exchange = exchange,
          .request = encode_access(exchange.request, octets_of(values...))};
}

struct ConfigurationSettings {
  Key app_key{};
  std::uint16_t destination = 0x0001;  ///< of what the robot publishes: a gateway, or their group
  std::uint8_t ttl = 4;
  std::vector<std::uint16_t> groups;
  std::optional<std::uint16_t> relay_group = {};  ///< of the updates that are relayed to robots
  NodeWishes wishes = {};
  bool had_relay_group = false;                   ///< the robot may hear a relay group
  std::uint8_t retransmit_count = 0;              ///< of its publications, by its composition
  RefreshState refresh = {};                      ///< for `refresh`: the step, and the new keys
  std::vector<ConfigurationStep> questions = {};  ///< of a `survey`
};

/// A node's answer to one question of a ping, an inquiry or a survey.
struct NodeAnswer {
  Opcode opcode = 0;
  std::optional<ModelElement> about;
  Bytes params;
  Duration after{};     ///< since the question was sent first
  unsigned copies = 0;  ///< sent copies of the question
  std::optional<std::uint8_t> ttl;
  std::optional<std::int8_t> rssi_dbm;
};

class NodeConfiguration {
 public:
  /// `move` changes only publications. `refresh` is a step of the key refresh. `ping` and `inquire`
  /// change nothing, `survey` changes only heartbeats.
  enum class Purpose : std::uint8_t { configure, move, refresh, reset, ping, inquire, survey };
  enum class State : std::uint8_t { running, succeeded, failed };

  /// One request is given up after this long.
  static constexpr Duration step_time_limit = std::chrono::seconds{20};
  /// The same for a request of a ping or a survey.
  static constexpr Duration ping_time_limit = std::chrono::seconds{5};
  /// A conversation is given up after this long, even if the node answers each request late.
  static constexpr Duration longest = std::chrono::minutes{10};
  /// A node in reach obeys a reset within this time. An earlier beacon may be spoofed.
  static constexpr Duration reset_time = std::chrono::seconds{5};
  /// The pause before a request is repeated, doubled each time: repeats come after 0.5 s, 1.5 s,
  /// 3.5 s ... For a segmented request the pauses are twice as long, because the radio repeats the
  /// segments by itself.
  static constexpr Duration first_pause = std::chrono::milliseconds{500};
  /// The pause if the radio was still sending an earlier segmented message to this node.
  static constexpr Duration refused_pause = std::chrono::milliseconds{150};

  /// `radio` must outlive this object.
  NodeConfiguration(const Node& node, Purpose purpose, ConfigurationSettings settings,
                    Radio& radio);

  /// The radio has added the device key, has removed it, or does not take it (`problem`).
  void on_key_used(const std::string& problem, TimePoint now);
  /// Sends the request under way when it is due, for the first time or again.
  void send_due(TimePoint now);
  /// Returns true if the message came under this node's device key, as answers do.
  bool on_message(const MessageReceived& message, TimePoint now);
  void on_send_refused(const std::string& why, TimePoint now);
  /// The node sends beacons of a device without a mesh, and no messages. So a reset has succeeded,
  /// even if its answer was lost: the node can't answer any more.
  void on_beacon(TimePoint now);
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);

  /// Returns `running` until the radio has removed the device key.
  State state() const { return stage_ == Stage::ended ? result_ : State::running; }
  Purpose purpose() const { return purpose_; }
  /// Returns the settings that the node was sent; newer ones may be wanted since.
  const ConfigurationSettings& settings() const { return settings_; }
  std::uint16_t address() const { return address_; }
  /// Returns why the conversation failed, or which requests the node refused; else empty.
  const std::string& problem() const { return problem_; }
  /// Returns the answers in a ping, an inquiry or a survey.
  const std::vector<NodeAnswer>& answers() const { return answers_; }

 private:
  enum class Stage : std::uint8_t { adding_key, talking, removing_key, ended };

  void begin_step(TimePoint now);
  bool keeps_answers() const {
    return purpose_ == Purpose::ping || purpose_ == Purpose::inquire || purpose_ == Purpose::survey;
  }
  Duration time_limit() const;
  std::vector<ConfigurationStep> plan(const Composition& composition);
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
  std::deque<ConfigurationStep> steps_;  ///< front: under way
  TimePoint talking_since_{};
  TimePoint step_since_{};
  TimePoint send_at_{};
  Duration pause_{};     ///< before the next repeat
  unsigned copies_ = 0;  ///< of the request under way
  std::string last_refusal_;
  std::vector<NodeAnswer> answers_;
};

}  // namespace slamgw::ble

// SPDX-License-Identifier: Apache-2.0
// Configures nodes, takes them through a key refresh, surveys them, and resets nodes that an
// operator removes. It chooses the next nodes, holds a few conversations at once, and handles the
// results. Part of Provisioner.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/provisioning/admission.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/hearing_survey.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/key_refresh.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_configuration.hpp"

namespace slamgw::ble {

class NodeConversations : private ProvisionerPart {
 public:
  /// A stock serial board sends four segmented messages at a time; one is left for commands to
  /// robots.
  static constexpr std::size_t max_conversations = 3;

  /// All references must outlive this object.
  NodeConversations(const ProvisionerPart& shared, Admission& admission, KeyRefresh& refresh,
                    HearingSurvey& survey)
      : ProvisionerPart(shared), admission_(admission), refresh_(refresh), survey_(survey) {}

  /// Returns true if the message was an answer in a conversation, not from a robot's own models.
  bool on_message(const MessageReceived& message, TimePoint now);
  void on_send_refused(std::uint16_t address, const std::string& why, TimePoint now);
  void on_link_down() { conversations_.clear(); }
  void on_key_used(const DeviceKeyUsed& used, TimePoint now);
  /// A device with this UUID is in no mesh, unless the beacon is spoofed.
  void on_beacon(const Uuid& uuid, TimePoint now);

  /// Continues all conversations, and handles the results of those that have ended.
  void continue_all(TimePoint now);
  void begin_due(TimePoint now);
  std::optional<TimePoint> deadline() const;

  bool is_idle() const { return conversations_.empty(); }
  /// Ends the conversation with a node that was left behind.
  void drop(std::uint16_t address);
  bool is_talking_with(const Node& node) const { return conversations_.contains(node.address); }

  /// Returns true, and only once, if the radio should restart before the next conversation. Its
  /// replay list may know the address of a node that has joined, or be full; only a restart empties
  /// it. One restart is tried for each robot.
  bool take_restart() { return std::exchange(wants_restart_, false); }

  /// The reset of a node has ended, or none is needed.
  void on_reset(const Node& node, bool is_done, const std::string& problem, TimePoint now);

 private:
  bool needs_configuration(const Node& node) const;
  NodeConfiguration::Purpose purpose_for(const Node& node) const;
  bool is_outdated(const Node& node) const;
  bool is_only_moved(const Node& node) const;
  bool has_right_groups(const Node& node) const;
  std::vector<std::uint16_t> groups_of(const Node& node) const;
  /// Returns the TTL that the robot should publish with.
  std::uint8_t ttl_of(const Node& node) const { return node.wishes.ttl.value_or(settings_.ttl); }
  /// Returns the address that robots should publish to.
  std::uint16_t destination() const { return settings_.gateway_group.value_or(link_.source); }
  bool hears(std::uint16_t address) const;
  bool begin_changes();
  bool may_be_unheard(const Node& node) const;
  std::optional<NodeConfiguration::Purpose> ordered_purpose() const;
  const Node* ordered_node() const;
  const Node* next_node(TimePoint now);
  std::optional<TimePoint> next_begin() const;
  std::optional<TimePoint> survey_due() const;
  void end(const NodeConfiguration& conversation, TimePoint now);
  void on_asked(const Node& node, const NodeConfiguration& conversation);
  void on_refreshed(const Node& node, const NodeConfiguration& conversation, TimePoint now);
  void on_configured(const Node& known, const ConfigurationSettings& sent);
  std::string put_off(const Node& node, const std::string& problem, TimePoint now);
  void on_not_configured(const Node& node, const std::string& problem, TimePoint now);
  static std::string changes_from(const Node& before, const ConfigurationSettings& sent);

  Admission& admission_;
  KeyRefresh& refresh_;
  HearingSurvey& survey_;
  std::map<std::uint16_t, NodeConfiguration> conversations_;  ///< by address
  bool wants_restart_ = false;
};

}  // namespace slamgw::ble

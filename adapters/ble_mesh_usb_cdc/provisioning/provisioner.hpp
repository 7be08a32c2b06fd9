// SPDX-License-Identifier: Apache-2.0
// Takes robots into the mesh and tells them how to live in it: scans, provisions one device at a
// time, configures a few nodes at once, does what operators order. Keeps the database of nodes.
// Knows the board only through commands and events. Called by BleMesh, which drains its actions.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <variant>

#include "adapters/ble_mesh_usb_cdc/mesh_action.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/board_link.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/address_plan.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/candidates.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/device_key_sweep.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/join_permit.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_ledger.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_configuration.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/provisioning_session.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/robot_names.hpp"

namespace slamgw::ble {

/// To the board; answered by on_command_ended unless the link goes down.
struct BoardCommand {
  Bytes frame;
};
struct SendUnderDeviceKey {
  std::uint16_t address = 0;
  std::uint16_t devkey_handle = 0;
  Bytes access;
};
/// Who belongs to the mesh, or how they are called, is different from before.
struct NodesChanged {};
/// The mesh has other keys than the board was started up with.
struct UseKeys {
  MeshKeys keys;
};
/// Answered by on_board_cleared.
struct ClearBoard {};

using ProvisionerAction = std::variant<BoardCommand, SendUnderDeviceKey, NodesChanged, UseKeys,
                                       ClearBoard, StoreMesh, OrderEnded, Notice>;

class Provisioner {
 public:
  /// The stock board sends four segmented messages at a time; one is left for commands to robots.
  static constexpr std::size_t max_conversations = 3;
  /// Sources whose sequence numbers the stock board remembers; it does not hear any more.
  static constexpr std::size_t replay_list_size = 40;
  /// A node is taken for reset only when it says so and was not heard for this long.
  static constexpr Duration reset_silence = std::chrono::seconds{5};
  static constexpr Duration scan_time = std::chrono::seconds{10};
  static constexpr Duration order_time_limit = std::chrono::seconds{150};
  /// For a device that an operator named to be heard.
  static constexpr Duration search_time_limit = std::chrono::seconds{30};

  Provisioner(const Settings& settings, RobotNames names, std::optional<NodeDatabase> database,
              RandomSource random);

  void on_link_up(std::uint16_t subnet_handle, SerialVersion version, TimePoint now);
  void on_link_down(const std::string& why, TimePoint now);
  void on_command_ended(const CommandEnded& ended, TimePoint now);
  void on_event(const ProvisioningEvent& event, TimePoint now);
  /// True when the message was for this and not from a robot's own models.
  bool on_message(const MessageReceived& message, TimePoint now);
  void on_send_refused(std::uint16_t address, const std::string& why, TimePoint now);
  /// Anything came from this unicast address.
  void on_heard(std::uint16_t address, TimePoint now);
  void on_iv_index(std::uint32_t iv_index, TimePoint now);
  /// A new mesh was made, and its keys are on disk.
  void on_new_mesh(const MeshKeys& keys);
  void on_stored(const std::string& problem, TimePoint now);
  void on_board_cleared(bool is_done, const std::string& why, TimePoint now);
  void on_order(std::uint64_t id, MeshOrder order, TimePoint now);
  /// What the configuration calls robots by now.
  void on_names(RobotNames names) { names_ = std::move(names); }

  const NodeDatabase* database() const { return ledger_.database(); }
  /// The database when the disk may not have it yet: to be written before the daemon ends.
  const NodeDatabase* unsaved() const { return ledger_.is_saved() ? nullptr : database(); }
  /// What the robot with this unicast address is called.
  std::string id_of(std::uint16_t address) const;

  std::optional<ProvisionerAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now) { advance(now); }

 private:
  /// What the command in flight is for.
  enum class Errand : std::uint8_t { scan_control, restart, session, sweep, conversation };
  struct InFlight {
    Errand errand = Errand::scan_control;
    std::uint16_t address = 0;  ///< of the conversation
  };
  /// A device that has its address and waits for the disk, or for the board's restart.
  struct Chosen {
    Uuid uuid{};
    bool needs_restart = false;    ///< the board's replay list may know its address
    bool is_last_context = false;  ///< the board's other context is busy
  };
  /// How things stand with one node, since the daemon started.
  struct Upkeep {
    std::optional<TimePoint> heard_at;
    std::optional<TimePoint> joined_at;
    TimePoint retry_at{};
    int failures = 0;
    std::string problem;
  };
  enum class OrderKind : std::uint8_t {
    scan,
    provision,
    remove,
    import_mesh,
    export_mesh,
    reset_board
  };
  struct Order {
    std::uint64_t id = 0;
    OrderKind kind = OrderKind::scan;
    TimePoint due{};
    Uuid uuid{};                         ///< provision, remove
    std::string robot;                   ///< provision, remove
    bool is_forced = false;              ///< remove
    std::optional<NodeDatabase> before;  ///< import
    std::uint16_t address = 0;           ///< export: of the other gateway
  };

  // provisioner.cpp: what is to be done now
  void advance(TimePoint now);
  void write_ledger(TimePoint now);
  void follow_session(TimePoint now);
  void follow_conversations(TimePoint now);
  void issue_next_command(TimePoint now);
  bool issue(std::optional<Bytes> frame, InFlight errand);
  bool wants_scan() const;
  /// Another gateway takes robots in and configures them.
  bool is_guest() const { return database() != nullptr && database()->guest_address; }
  void close_permit(TimePoint now);
  void say(Severity severity, std::string text, std::string robot = {});

  // provisioner_joining.cpp: devices become nodes
  bool is_wanted(const Candidate& candidate, TimePoint now) const;
  void choose_next(TimePoint now);
  bool reserve(const Candidate& candidate, const std::string& name, TimePoint now);
  /// Of others than nodes: gateways, and robots that another tool has taken in.
  std::set<std::uint16_t> taken_addresses() const;
  std::optional<std::uint16_t> address_for(const Candidate& candidate,
                                           const std::string& name) const;
  void begin_session(TimePoint now);
  void keep_addresses(TimePoint now);
  void on_joined(TimePoint now);
  void on_session_failed(TimePoint now);
  bool make_room();
  void warn_of_replay_list(const Node& node);

  // provisioner_nodes.cpp: nodes are configured and reset
  void begin_conversations(TimePoint now);
  bool wants_configuration(const Node& node) const;
  bool is_outdated(const Node& node) const;
  bool begin_changes();
  const Node* next_node(TimePoint now);
  void end_conversation(NodeConfiguration conversation, TimePoint now);
  void on_configured(const Node& known);
  std::string changes_from(const Node& before) const;
  void on_not_configured(const Node& node, const std::string& problem, TimePoint now);
  void on_reset(const Node& node, bool is_done, const std::string& problem, TimePoint now);
  void forget(const Node& node);
  std::optional<TimePoint> next_configuration() const;

  // provisioner_orders.cpp: operators
  void take_scan(TimePoint now);
  void take_reset(TimePoint now);
  void take(const ProvisionOrder& wanted, TimePoint now);
  void take(const RemoveOrder& wanted, TimePoint now);
  void take(const ImportOrder& wanted, TimePoint now);
  void take_export(TimePoint now);
  std::optional<std::uint16_t> address_for_gateway() const;
  void permit_join(std::uint64_t id, const PermitJoinOrder& wanted, TimePoint now);
  std::string problem_with_name(const std::string& robot, const std::optional<Uuid>& uuid) const;
  void answer(std::string json);
  void refuse(std::string why);
  void on_order_due(TimePoint now);
  std::string scan_json(TimePoint now) const;
  std::string nodes_json() const;
  bool is_ordered(OrderKind kind) const { return order_ && order_->kind == kind; }
  bool is_ordered(OrderKind kind, const Uuid& uuid) const {
    return is_ordered(kind) && order_->uuid == uuid;
  }
  std::string node_json(const Node& node) const;
  const std::string* configured_name(std::uint16_t address) const;

  Settings settings_;
  std::optional<Key> static_oob_;
  RobotNames names_;
  RandomSource random_;
  MeshLedger ledger_;
  ActionQueue<ProvisionerAction> actions_;

  bool is_up_ = false;
  std::string down_reason_ = "not started";
  std::uint16_t subnet_handle_ = 0;
  SerialVersion version_ = SerialVersion::sdk_3_1;  ///< of the board's firmware
  std::optional<InFlight> in_flight_;
  bool is_scanning_ = false;
  Candidates candidates_;
  JoinPermit permit_;
  std::optional<Chosen> chosen_;
  std::optional<ProvisioningSession> session_;
  std::uint8_t context_ = 0;      ///< of the session; the other one next time, as this may hang
  bool is_last_context_ = false;  ///< of the session
  std::map<std::uint16_t, NodeConfiguration> conversations_;  ///< by address
  std::optional<DeviceKeySweep> sweep_;
  bool is_swept_ = false;
  std::map<Uuid, Upkeep> upkeep_;
  /// Heard, but no node: robots that another tool has taken in. At most NodeDatabase::max_nodes.
  std::set<std::uint16_t> strangers_;
  std::optional<Order> order_;
  bool was_store_problem_said_ = false;
};

/// 32 hex digits, hyphens allowed.
std::optional<Uuid> parse_uuid(std::string_view text);

}  // namespace slamgw::ble

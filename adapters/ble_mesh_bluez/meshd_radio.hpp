// SPDX-License-Identifier: Apache-2.0
// BlueZ's bluetooth-meshd as the mesh's radio: decides when to make which call, and reads the
// answers. meshd keeps sequence numbers, IV index and replay list of its node on disk, acknowledges
// segments and runs the provisioning protocol itself. Called by BleMesh; MeshdAdapter passes it the
// events of D-Bus, and performs its requests. No D-Bus here.
#pragma once

#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "adapters/ble_mesh_bluez/meshd_call.hpp"
#include "adapters/ble_mesh_usb_cdc/access/config_messages.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/protocol_machine.hpp"

namespace slamgw::ble {

/// The one model of the gateway's node that hears application messages, the sensor_update server.
/// meshd delivers each message to the application once for each element, whatever its models, so
/// one is enough. A node keeps its composition for good: meshd refuses an application with another
/// one.
inline constexpr ModelId gateway_model{0x0059, 0x0005};

/// meshd's node, as `mesh.json` keeps it: "bluez UUID TOKEN". The token is a secret: it gives
/// control of the node.
struct MeshdNode {
  Uuid uuid{};
  std::optional<std::uint64_t> token;  ///< nothing until meshd has made the node
};
std::string encode_node(const MeshdNode& node);
std::optional<MeshdNode> decode_node(std::string_view text);

class MeshdRadio final : public Radio {
 public:
  /// Messages that may wait to be sent. Further messages are dropped; their senders repeat them.
  static constexpr std::size_t max_waiting = 32;
  /// The longest message of the SAR of Mesh Profile 1.0 section 3.5.3.1, less the MIC.
  static constexpr std::size_t max_access_bytes = 380;
  /// The node sends each packet this often. meshd drops a packet when the controller has not done
  /// its four commands before the next one: at 20 ms, a slow computer lost one packet of 25.
  static constexpr Transmissions transmissions{2, 40};
  static constexpr Duration packet_time = std::chrono::milliseconds{80};
  /// meshd reports a device once for each scan, so a scan starts again after this time.
  static constexpr Duration rescan_after = std::chrono::seconds{2};
  static constexpr Duration retry_after = std::chrono::seconds{2};
  static constexpr Duration step_time_limit = std::chrono::seconds{3};
  /// To make a node, to attach to it, and for each call that prepares it.
  static constexpr Duration node_time_limit = std::chrono::seconds{10};
  /// Without an answer to a message, or to the question for the IV index, for this time, the link
  /// is down: meshd would send what it is given once it runs again. sd-bus alone waits for 25 s.
  static constexpr Duration answer_time_limit = std::chrono::seconds{3};
  static constexpr int max_copies = 4;  ///< of one configuration message to the own node
  /// meshd itself gives up an attempt after 60 s.
  static constexpr Duration join_time_limit = std::chrono::seconds{90};
  /// The question for the IV index shows that an idle meshd still answers.
  static constexpr Duration iv_index_interval = std::chrono::seconds{10};

  /// The radio of the mesh with this database, whose last radio may have been another one. `random`
  /// makes the UUID and the device key of the gateway's node.
  MeshdRadio(Settings settings, const std::optional<NodeDatabase>& database, RandomSource random)
      : settings_(std::move(settings)),
        keys_(radio_keys(database)),
        random_(std::move(random)),
        node_(database ? decode_node(database->life.radio) : std::nullopt) {}

  void on_event(MeshdEvent& event, TimePoint now);

  std::size_t max_send_bytes() const override { return max_access_bytes; }
  /// The length of the replay list that the node asks meshd for (CRPL).
  std::size_t max_senders() const override { return last_unicast_address; }
  bool hears_earlier_lives() const override { return false; }
  Counters counters() const override {
    return {{"sends_refused", refused_}, {"sends_dropped", dropped_}};
  }
  void send(Outgoing message, TimePoint now) override;
  void withdraw(std::uint16_t destination, const Bytes& payload) override;
  bool is_idle() const override { return waiting_.empty(); }
  void scan(bool is_on) override { is_scan_wanted_ = is_on; }
  void provision(const ProvisionDevice& device) override { join_ = Join{device}; }
  void answer_device(const std::string& refusal, TimePoint now) override;
  void break_off_join(const std::string& why) override {
    if (join_ && !join_->has_address) end_join({.failure = why});
  }
  void use_device_key(std::uint16_t address, const std::optional<Key>& key) override;
  /// meshd keeps the keys of all nodes, until the gateway's node leaves.
  void forget_device_key(std::uint16_t address) override {
    actions_.push(DeviceKeyUsed{address, {}});
  }
  void on_keys_failed(const std::string& why, TimePoint now) override;
  void change_keys(const RadioKeys& keys, TimePoint now) override;
  void use_source(std::uint16_t source, std::uint16_t count, TimePoint now) override;
  void delay_source(const std::string& why) override { go_down(why); }
  void clear(TimePoint now) override;
  bool restart(TimePoint now) override;

  std::optional<RadioAction> next_action(TimePoint now) override;
  std::optional<MeshdRequest> next_request() { return requests_.pop(); }
  std::optional<TimePoint> deadline() const override;
  void on_deadline(TimePoint now) override;

 private:
  enum class Stage : std::uint8_t {
    absent,           ///< meshd is not on the bus
    pausing,          ///< until retry_at_
    awaiting_keys,    ///< of a new mesh
    awaiting_source,  ///< the node's address must be on disk
    importing,        ///< meshd makes the node
    awaiting_disk,    ///< the disk must have the token
    attaching,
    preparing,  ///< runs steps_
    up,
    leaving,
  };

  /// One step of preparing the node. A call is done when meshd has answered it; a configuration
  /// message, when the node has answered, too.
  struct Step {
    MeshdCall call;
    Opcode answer = 0;
    bool has_status = true;  ///< `answer` has a status, which must be success
  };

  using Done = std::function<void(const MeshdAnswer&, TimePoint)>;
  struct Join {
    ProvisionDevice device;
    std::optional<TimePoint> due = {};  ///< nothing: not begun
    bool has_static_oob = false;
    bool has_address = false;
    bool has_joined = false;  ///< its keys are awaited
    std::string refusal = {};
  };

  void on(const MeshdCame&, TimePoint now);
  void on(const MeshdGone& gone, TimePoint);
  void on(const MeshdAnswer& answer, TimePoint now);
  void on(const JoinComplete& complete, TimePoint);
  void on(const ScanResult& result, TimePoint);
  void on(const StaticOobGiven&, TimePoint);
  void on(const RequestProvData& wanted, TimePoint now);
  void on(const AddNodeComplete& added, TimePoint);
  void on(const AddNodeFailed& failed, TimePoint);
  void on(AppMessage& message, TimePoint);
  void on(DevKeyMessage& message, TimePoint now);
  void call(MeshdCall call, Done done);
  void begin(TimePoint now);
  void pause(const std::string& why, Duration time, TimePoint now);
  void go_down(const std::string& why, bool is_restart = false);
  void forget();
  void begin_node(TimePoint now);
  void ask_for_source(std::uint16_t addresses);
  void make_node(TimePoint now);
  void attach(TimePoint now);
  void refuse_node(const std::string& what, TimePoint now);
  void on_attached(const MeshdAnswer& answer, TimePoint now);
  void leave(const std::string& why, bool is_restart = false);
  void plan();
  void plan_refresh();
  void configure(const Exchange& exchange, const auto&... params);
  void do_step(TimePoint now);
  void on_step_answer(const MeshdAnswer& answer, TimePoint now);
  void on_configured(const AccessMessage& answer, TimePoint now);
  void end_step(TimePoint now);
  void come_up(TimePoint now);
  void ask_iv_index(TimePoint now);
  void begin_join(TimePoint now);
  void run_scan(TimePoint now);
  void end_join(JoinEnded ended);
  void send_next(TimePoint now);

  Settings settings_;
  std::optional<RadioKeys> keys_;
  RandomSource random_;
  std::optional<MeshdNode> node_;
  ActionQueue<RadioAction> actions_;
  ActionQueue<MeshdRequest> requests_;

  Stage stage_ = Stage::absent;
  std::string down_reason_;
  std::optional<TimePoint> retry_at_;
  std::uint64_t last_call_ = 0;
  std::map<std::uint64_t, Done> calls_;  ///< calls without an answer yet, by number
  std::uint16_t source_ = 0;
  std::optional<Key> own_device_key_;  ///< of a node that has not been up yet
  bool is_clearing_ = false;           ///< RadioCleared is owed

  std::deque<Step> steps_;
  int copies_ = 0;
  std::optional<TimePoint> step_due_;

  std::deque<Outgoing> waiting_;
  /// Set while meshd has not answered a message or the question for the IV index.
  std::optional<TimePoint> answer_due_;
  TimePoint air_free_at_{};  ///< the last message is on the air until then
  bool is_scan_wanted_ = false;
  std::optional<TimePoint> rescan_at_;  ///< set while meshd scans
  std::optional<Join> join_;
  TimePoint ask_iv_at_{};
  std::uint64_t refused_ = 0;
  std::uint64_t dropped_ = 0;
};

}  // namespace slamgw::ble

// SPDX-License-Identifier: Apache-2.0
// Devices become nodes, one at a time: who joins next, which address it gets, and what came of it.
// Part of Provisioner.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/nordic/board_link.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/commands.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/ecdh.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/events.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/provisioning_session.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_table.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/provisioner_action.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

/// Devices that say they are in no mesh: when each was heard, and which is next. After a failure a
/// device waits longer each time, so that it does not hold up the others. Called by Admission.
struct Candidate {
  Uuid uuid{};
  std::int8_t rssi_dbm = 0;
  TimePoint first_heard{};
  TimePoint last_heard{};
  TimePoint not_before{};  ///< of the next attempt
  int failures = 0;
  std::uint8_t elements = 1;  ///< as it said at an earlier attempt
};

class Candidates {
 public:
  /// The one that was silent for longest makes room.
  static constexpr std::size_t max_candidates = 64;
  /// Beacons come every few seconds (Mesh Profile 1.0 section 3.9.2); one silent for this long has
  /// gone.
  static constexpr Duration max_silence = std::chrono::seconds{60};
  static constexpr Duration first_pause = std::chrono::seconds{5};
  static constexpr Duration max_pause = std::chrono::minutes{5};

  using Filter = std::function<bool(const Candidate&)>;

  void on_beacon(const UnprovisionedBeacon& beacon, TimePoint now);
  void on_failure(const Uuid& uuid, TimePoint now);
  void on_elements(const Uuid& uuid, std::uint8_t elements);
  void erase(const Uuid& uuid) { candidates_.erase(uuid); }

  const Candidate* find(const Uuid& uuid, TimePoint now) const;
  /// The one with the fewest failures, then the first heard, among those that are due and wanted.
  const Candidate* next(const Filter& is_wanted, TimePoint now) const;
  /// The devices that were heard lately.
  std::vector<Candidate> all(TimePoint now) const;

 private:
  std::map<Uuid, Candidate> candidates_;
};

/// 5 s, 10 s, 20 s ... after the first, second, third failure; at most five minutes.
Duration pause_after(int failures);

/// For how long an operator lets new robots in although `ble_mesh.provisioning.enabled` is false,
/// and what has come of it (`slam-gatewayctl ble permit-join`). Forgotten when the daemon ends.
/// Pure; part of Admission.
class JoinPermit {
 public:
  static constexpr std::chrono::minutes longest{24 * 60};
  /// Events of the permit that are kept. A new one replaces the oldest.
  static constexpr std::size_t max_events = 256;

  /// `robot`: the name of the one robot that may join; empty: all may. A permit that is open is
  /// replaced.
  void open(std::chrono::minutes time, std::string robot, TimePoint now);
  void close() { until_.reset(); }
  bool is_open() const { return until_.has_value(); }
  /// Closes it when its time is over; true when it was closed now.
  bool on_time(TimePoint now);
  std::optional<TimePoint> deadline() const { return until_; }

  /// Whether this device may join now.
  bool admits(const Uuid& uuid) const;
  /// The name that it will get; empty: as the configuration says.
  const std::string& robot() const { return robot_; }

  /// A device was chosen while the permit was open. The other events are noted only of such
  /// devices.
  void on_chosen(const Uuid& uuid);
  void on_joined(const Uuid& uuid, const std::string& robot);
  void on_configured(const Uuid& uuid, const std::string& robot);
  /// It did not join, or could not be configured yet.
  void on_failed(const Uuid& uuid, const std::string& why);

  /// `seconds_left`, `under_way` (devices that were chosen and have not ended), and the `events`
  /// after number `after`: `number`, `event` (`joining`, `joined`, `configured`, `failed`), `uuid`,
  /// `robot`, `why`.
  std::string json(std::uint64_t after, TimePoint now) const;

 private:
  struct Event {
    std::uint64_t number = 0;
    std::string_view what;
    Uuid uuid{};
    std::string robot;
    std::string why;
  };

  void note(std::string_view what, const Uuid& uuid, std::string robot, std::string why);

  std::optional<TimePoint> until_;
  std::string robot_;
  std::optional<Uuid> named_;  ///< the device that gets the name
  std::set<Uuid> under_way_;
  std::deque<Event> events_;
  std::uint64_t last_number_ = 0;
};

/// Empties the board's table of device keys before the first conversation with a node: keys that an
/// earlier run left there have handles that no command reads, and a second Devkey Add for the same
/// node is refused. Called by NodeConversations while none is under way.
class DeviceKeySweep {
 public:
  /// The command that the board should get now; nothing when all is done.
  std::optional<Bytes> command() const {
    if (!first_) return encode_command(CommandOpcode::appkey_count_max_get);
    if (!end_) return encode_command(CommandOpcode::devkey_count_max_get);
    if (next_ >= *end_) return std::nullopt;
    return encode_command(CommandOpcode::devkey_delete, next_);
  }
  /// Most deletions are refused, because nothing is there.
  void on_command_ended(const CommandEnded& ended) {
    ByteReader data(ended.data);
    const std::uint16_t count = std::min(data.read_u16_le(), max_keys);
    if (!first_) {  // handles of device keys follow those of application keys
      first_ = data.ok() ? count : stock_appkeys;
      next_ = *first_;
    } else if (!end_) {
      end_ = static_cast<std::uint16_t>(*first_ + (data.ok() ? count : stock_devkeys));
    } else {
      ++next_;
    }
  }
  bool is_done() const { return end_ && next_ >= *end_; }

 private:
  static constexpr std::uint16_t stock_appkeys = 8;
  static constexpr std::uint16_t stock_devkeys = 10;
  static constexpr std::uint16_t max_keys = 64;

  std::optional<std::uint16_t> first_;
  std::optional<std::uint16_t> end_;
  std::uint16_t next_ = 0;
};

/// The one order of an operator that is under way, and its answer. Part of Provisioner;
/// OperatorOrders opens it, the part that fulfils it answers it.
class OpenOrder {
 public:
  enum class Kind : std::uint8_t { scan, provision, remove, import_mesh, export_mesh, reset_board };
  struct Order {
    std::uint64_t id = 0;
    Kind kind = Kind::scan;
    TimePoint due{};
    Uuid uuid{};                              ///< provision, remove
    std::string robot = {};                   ///< provision
    bool is_forced = false;                   ///< remove
    std::optional<NodeDatabase> before = {};  ///< import
    std::uint16_t address = 0;                ///< export: of the other gateway
  };

  explicit OpenOrder(ProvisionerActions& actions) : actions_(actions) {}

  explicit operator bool() const { return order_.has_value(); }
  Order& operator*() { return *order_; }
  Order* operator->() { return &*order_; }
  bool is(Kind kind) const { return order_ && order_->kind == kind; }
  bool is(Kind kind, const Uuid& uuid) const { return is(kind) && order_->uuid == uuid; }
  std::optional<TimePoint> deadline() const {
    return order_ ? std::optional(order_->due) : std::nullopt;
  }

  void open(Order order) { order_ = std::move(order); }
  /// Ends it with a JSON document.
  void answer(std::string json) { end({std::move(json), {}}); }
  /// Ends it with a sentence for the operator.
  void refuse(std::string why) { end({{}, std::move(why)}); }

 private:
  void end(OrderAnswer answer) {
    actions_.push(OrderEnded{order_->id, std::move(answer)});
    order_.reset();
  }

  ProvisionerActions& actions_;
  std::optional<Order> order_;
};

class Admission {
 public:
  /// The stock board remembers the sequence numbers of so many sources, and does not hear others.
  static constexpr std::size_t replay_list_size = 40;
  /// A node is taken for reset only when it says so and was not heard for this long.
  static constexpr Duration reset_silence = std::chrono::seconds{5};
  static constexpr Duration order_time_limit = std::chrono::seconds{150};

  /// Whether a conversation with the node is under way, so that it must not be provisioned anew.
  using IsBusy = std::function<bool(const Node&)>;

  /// All but `random` outlive it.
  Admission(const Settings& settings, const BoardState& board, NodeTable& nodes, OpenOrder& order,
            ProvisionerActions& actions, RandomSource random);

  void on_event(const ProvisioningEvent& event, TimePoint now);
  void on_link_down(TimePoint now);
  void on_command_ended(const CommandEnded& ended);

  /// Carries the session under way on. `is_board_free`: no command is in flight.
  void continue_session(bool is_board_free, TimePoint now);
  void choose_next(const IsBusy& is_busy, TimePoint now);
  /// The command that the session under way has for the board.
  std::optional<Bytes> command() const { return session_ ? session_->command() : std::nullopt; }
  std::optional<TimePoint> deadline() const {
    return session_ ? session_->deadline() : std::nullopt;
  }

  bool wants_scan() const;
  bool is_idle() const { return !session_ && !chosen_; }
  /// This device is joining now.
  bool is_joining(const Uuid& uuid) const { return session_ && session_->uuid() == uuid; }
  /// This device is joining now, or next.
  bool is_chosen(const Uuid& uuid) const {
    return is_joining(uuid) || (chosen_ && chosen_->uuid == uuid);
  }

  JoinPermit& permit() { return permit_; }
  const JoinPermit& permit() const { return permit_; }
  Candidates& candidates() { return candidates_; }

 private:
  /// A device that has its address and waits for the disk.
  struct Chosen {
    Uuid uuid{};
    bool is_last_context = false;  ///< the board's other context is busy
  };

  bool is_open() const { return settings_.provisioning.enabled || permit_.is_open(); }
  bool is_wanted(const Candidate& candidate, const IsBusy& is_busy, TimePoint now) const;
  bool was_silent(const Node& node, TimePoint now) const;
  bool reserve(const Candidate& candidate, const std::string& name, TimePoint now);
  void keep(const Candidate& candidate, std::uint16_t address, const std::string& name);
  bool make_room();
  void begin_session(TimePoint now);
  void keep_addresses(TimePoint now);
  void on_joined(TimePoint now);
  void on_session_failed(TimePoint now);
  void release(const Uuid& uuid);
  void warn_of_replay_list(const Node& node);
  void notify(Severity severity, std::string text, std::string robot = {}) {
    actions_.push(Notice{severity, std::move(text), std::move(robot)});
  }

  const Settings& settings_;
  const BoardState& board_;
  NodeTable& nodes_;
  OpenOrder& order_;
  ProvisionerActions& actions_;
  RandomSource random_;
  std::optional<Key> static_oob_;
  Candidates candidates_;
  JoinPermit permit_;
  std::optional<Chosen> chosen_;
  std::optional<ProvisioningSession> session_;
  std::uint8_t context_ = 0;      ///< of the session; the other one next time, as this may hang
  bool is_last_context_ = false;  ///< of the session
};

}  // namespace slamgw::ble

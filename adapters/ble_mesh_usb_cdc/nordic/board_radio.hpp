// SPDX-License-Identifier: Apache-2.0
// Nordic's serial board as the mesh's radio. Turns the mesh's requests into serial commands, one at
// a time, and the board's events into those of radio.hpp. Keeps the board's table of device keys
// and the session with a device that joins. BoardTraffic has the messages to robots, and BoardLink
// handles the line. Called by BleMesh.
#pragma once

#include <algorithm>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/nordic/board_link.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/board_traffic.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/provisioning_session.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/log_throttle.hpp"

namespace slamgw::ble {

/// Deletes unknown keys from the board's table of device keys before the first key is added. No
/// command reads the handles of keys that an earlier run left there, and the board refuses a second
/// Devkey Add for a node. Called by BoardRadio.
class DeviceKeySweep {
 public:
  /// Returns the command that the board should get now; nothing when no unknown key is left.
  /// `is_own` returns true for the handles of BoardRadio's own keys.
  std::optional<Bytes> command(const auto& is_own) {
    if (!first_) return encode_command(CommandOpcode::appkey_count_max_get);
    if (!end_) return encode_command(CommandOpcode::devkey_count_max_get);
    while (next_ < *end_ && is_own(next_)) ++next_;
    if (next_ >= *end_) return std::nullopt;
    return encode_command(CommandOpcode::devkey_delete, next_);
  }
  /// Takes the response to that command. Most deletions are refused: the handle has no key.
  void on_response(const CommandResponse& response) {
    ByteReader data(response.data);
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

 private:
  static constexpr std::uint16_t stock_appkeys = 8;
  static constexpr std::uint16_t stock_devkeys = 10;
  static constexpr std::uint16_t max_keys = 64;

  std::optional<std::uint16_t> first_;
  std::optional<std::uint16_t> end_;
  std::uint16_t next_ = 0;
};

class BoardRadio final : public Radio {
 public:
  /// The replay list of a stock board.
  static constexpr std::size_t replay_list_size = 40;
  /// Messages that are not urgent wait while a device joins, but no longer than this. The board's
  /// answers to them could take the place of its one event with the device key.
  static constexpr Duration longest_hold = std::chrono::seconds{10};

  /// The radio of the mesh with this database. `random` makes the key pairs of provisioning, `seed`
  /// the Echo nonces.
  BoardRadio(const Settings& settings, const std::optional<NodeDatabase>& database,
             RandomSource random, std::uint64_t seed)
      : traffic_(settings.ttl, actions_),
        link_(settings, radio_keys(database), seed),
        random_(std::move(random)) {}

  std::size_t max_send_bytes() const override { return send_limit(traffic_.board().version); }
  std::size_t max_senders() const override { return replay_list_size; }
  bool hears_earlier_lives() const override { return true; }
  Counters counters() const override;
  void send(Outgoing message, TimePoint now) override;
  void withdraw(std::uint16_t destination, const Bytes& payload) override {
    traffic_.withdraw(destination, payload);
  }
  bool is_idle() const override { return traffic_.is_idle() && !command_; }
  void scan(bool is_on) override { is_scan_wanted_ = is_on; }
  void provision(const ProvisionDevice& device) override;
  void answer_device(const std::string& refusal, TimePoint now) override;
  void break_off_join(const std::string& why) override;
  void use_device_key(std::uint16_t address, const std::optional<Key>& key) override;
  void forget_device_key(std::uint16_t address) override;
  void on_keys_failed(const std::string& why, TimePoint now) override {
    link_.on_keys_failed(why, now);
  }
  void change_keys(const RadioKeys& keys, TimePoint now) override { link_.change_keys(keys, now); }
  void use_source(std::uint16_t source, std::uint16_t count, TimePoint now) override {
    link_.on_source(source, count, now);
  }
  void delay_source(const std::string& why) override { link_.on_source_delayed(why); }
  void clear(TimePoint now) override;
  bool restart(TimePoint now) override;

  void on_port_open(TimePoint now) override { link_.on_port_open(now); }
  void on_port_closed(const std::string& why, TimePoint now) override {
    link_.on_port_closed(why, now);
  }
  void on_bytes(ByteView bytes, TimePoint now) override { link_.on_bytes(bytes, now); }

  std::optional<RadioAction> next_action(TimePoint now) override;
  std::optional<TimePoint> deadline() const override {
    return earlier(earlier(scan_retry_at_, hold_until_),
                   earlier(link_.deadline(), session_ ? session_->deadline() : std::nullopt));
  }
  void on_deadline(TimePoint now) override;

 private:
  /// A command other than those of `traffic_`. The board gets it again if its answer is lost.
  struct Command {
    enum class Purpose : std::uint8_t { restart, scan_control, session, sweep, device_key };
    Purpose purpose;
    Bytes frame;
    std::uint16_t node = 0;  ///< whose device key it is about
    bool is_repeat = false;  ///< the first answer was lost: the board may have obeyed then
  };

  /// The device key of one node: as it is wanted, and as the board has it.
  struct DeviceKey {
    std::optional<Key> wanted = {};            ///< empty: the board is to delete the key
    std::optional<Key> on_board = {};          ///< also while the command that adds it is in flight
    std::optional<std::uint16_t> handle = {};  ///< set while the board has the key

    bool is_there() const { return handle && wanted == on_board; }
  };

  bool is_commanded(std::uint16_t address) const {
    return command_ && command_->purpose == Command::Purpose::device_key &&
           command_->node == address;
  }
  void on_started(const StartedBoard& board);
  void on_response(const CommandResponse& response, TimePoint now);
  void on_answer_lost();
  void on_scan_changed(const CommandResponse& response, TimePoint now);
  void on_device_key(const Command& command, const CommandResponse& response);
  void on_event(const ProvisioningEvent& event, TimePoint now);
  void on_message(MessageReceived& message);
  void on_link_down(LinkIsDown& down);
  bool begin_session(TimePoint now);
  void end_session();
  bool begin_next(TimePoint now);
  std::optional<Command> choose();
  std::optional<Command> key_command();
  void forget();

  ActionQueue<RadioAction> actions_;
  BoardTraffic traffic_;
  BoardLink link_;
  RandomSource random_;
  std::uint64_t sends_dropped_ = 0;      ///< not taken: the link was down or the queue full
  std::optional<Command> command_;       ///< in flight or next, until its answer is there
  std::optional<TimePoint> hold_until_;  ///< while a device joins
  bool is_restart_wanted_ = false;
  bool is_scan_wanted_ = false;
  bool is_scanning_ = false;                ///< as the board has answered
  std::optional<TimePoint> scan_retry_at_;  ///< set while the board has refused to change it
  LogThrottle scan_lines_{std::chrono::hours{1}};
  std::optional<ProvisionDevice> device_;  ///< the device that joins or waits for the board
  std::optional<ProvisioningSession> session_;
  std::uint8_t context_ = 0;      ///< of the session; the next one uses the other, as this may hang
  bool is_last_context_ = false;  ///< the board's other context is busy
  DeviceKeySweep sweep_;
  std::map<std::uint16_t, DeviceKey> device_keys_;  ///< by their nodes' addresses
};

}  // namespace slamgw::ble

// SPDX-License-Identifier: Apache-2.0
// The provisioning of one device, from the key pair to the end of the provisioning link (Mesh
// Profile 1.0 section 5.4.1). The board speaks with the device; this class answers the board. Never
// printed. Called by BoardRadio.
#pragma once

#include <deque>
#include <optional>
#include <string>

#include "adapters/ble_mesh_usb_cdc/nordic/serial_protocol.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/start_up.hpp"
#include "daemon/core/protocol_machine.hpp"

namespace slamgw::ble {

// P-256 for provisioning (Mesh Profile 1.0 section 5.4.2.3), which the serial board leaves to its
// host. Arithmetic only: randomness comes from the caller. Never printed.

/// Returns a fresh key pair for one provisioning; nothing without randomness.
std::optional<KeyPair> make_key_pair(const RandomSource& random);
/// Returns nothing if the private key is 0 or not below the order of the curve.
std::optional<KeyPair> key_pair_of(const std::array<std::uint8_t, 32>& private_key);
/// Returns the X coordinate of the common point. Returns nothing if `peer` is not on the curve:
/// that is an attack, and Mesh Profile 1.0 section 5.4.3.1 wants it refused.
std::optional<SharedSecret> shared_secret(const KeyPair& own, const PublicKey& peer);

class ProvisioningSession {
 public:
  enum class State : std::uint8_t { running, succeeded, failed };

  /// Time limit for each event that the session waits for.
  static constexpr Duration wait_limit = std::chrono::seconds{15};
  /// Time limit for the end of the link once all else is done.
  static constexpr Duration close_limit = std::chrono::seconds{3};

  /// `context` is the board's provisioning link for this session. `actions` takes DeviceAnswered
  /// and DeviceJoined, and must outlive this object.
  ProvisioningSession(const ProvisionDevice& device, const KeyPair& key_pair, std::uint8_t context,
                      const StartedBoard& board, ActionQueue<RadioAction>& actions, TimePoint now);

  /// Returns the command that the board should get now, the same one until on_response().
  std::optional<Bytes> command() const;
  /// `is_repeat`: the first answer was lost, and the board may have obeyed then.
  void on_response(const CommandResponse& response, bool is_repeat);
  void on_event(const ProvisioningEvent& event, TimePoint now);
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);

  State state() const { return state_; }
  /// The result; complete when the state is not `running`.
  const JoinEnded& end() const { return end_; }
  /// Returns true if the board did not even begin: its context still waits for the end of an
  /// earlier link.
  bool is_context_busy() const { return is_context_busy_; }
  /// Returns true while the session waits until each element has an address on disk.
  bool wants_addresses() const {
    return state_ == State::running && stage_ == Stage::awaiting_addresses;
  }
  void on_addresses(TimePoint now);
  /// Returns true if the board has the shared secret, so that the device may join without its host.
  bool may_have_joined() const { return stage_ >= Stage::completing; }
  /// Returns true if this event has the device key that the session waits for.
  bool awaits(const ProvisioningComplete& event) const {
    return state_ == State::running && stage_ == Stage::completing && event.context == context_;
  }
  void fail(std::string why);
  /// Fails because no answer can come any more: in the last step the device may have joined.
  void on_link_lost(std::string why);

 private:
  enum class Stage : std::uint8_t {
    opening,
    awaiting_capabilities,
    awaiting_addresses,
    exchanging,
    completing,  ///< the board has the shared secret: the device may join at any moment
    counting,    ///< the key is lost; the board is asked how many events it has dropped
    closing      ///< the device has joined; only the link has to end
  };

  // The board's events about this session's link.
  void on(const ProvisioningLinkOpened& event, TimePoint now);
  void on(const ProvisioningLinkClosed& event, TimePoint now);
  void on(const CapabilitiesReceived& event, TimePoint now);
  void on(const AuthenticationRequested& event, TimePoint now);
  void on(const EcdhRequested& event, TimePoint now);
  void on(const ProvisioningComplete& event, TimePoint now);
  void on(const ProvisioningFailed& event, TimePoint now);
  void enter(Stage stage, TimePoint now);

  KeyPair key_pair_;
  ActionQueue<RadioAction>& actions_;
  std::uint8_t context_;
  std::uint32_t dropped_before_;  ///< events, up to the board's start-up
  std::optional<Key> static_oob_;
  State state_ = State::running;
  Stage stage_ = Stage::opening;
  TimePoint due_;
  JoinEnded end_;
  bool is_context_busy_ = false;
  bool offers_static_oob_ = false;
  std::deque<Bytes> commands_;  ///< at most four: one device causes no more
};

}  // namespace slamgw::ble

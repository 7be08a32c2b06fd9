// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/provisioning_session.hpp"

#include <fmt/format.h>
#include <openssl/bn.h>
#include <openssl/ec.h>
#include <openssl/obj_mac.h>

#include <algorithm>
#include <array>
#include <memory>
#include <utility>

#include "daemon/core/freed_by.hpp"

namespace slamgw::ble {

namespace {

using Number = std::unique_ptr<BIGNUM, FreedBy<BN_clear_free>>;
using Group = std::unique_ptr<EC_GROUP, FreedBy<EC_GROUP_free>>;
using Point = std::unique_ptr<EC_POINT, FreedBy<EC_POINT_clear_free>>;

constexpr std::size_t coordinate_bytes = 32;
/// A random number is out of range once in 2^32 times.
constexpr int max_draws = 8;

Group p256() { return Group(EC_GROUP_new_by_curve_name(NID_X9_62_prime256v1)); }

Number number_of(ByteView octets) {
  return Number(BN_bin2bn(octets.data(), static_cast<int>(octets.size()), nullptr));
}

bool write_number(const BIGNUM* number, std::span<std::uint8_t> octets) {
  return BN_bn2binpad(number, octets.data(), static_cast<int>(octets.size())) ==
         static_cast<int>(octets.size());
}

}  // namespace

std::optional<KeyPair> make_key_pair(const RandomSource& random) {
  std::array<std::uint8_t, coordinate_bytes> scalar{};
  for (int draw = 0; draw < max_draws && random(scalar); ++draw)
    if (auto pair = key_pair_of(scalar)) return pair;
  return std::nullopt;
}

std::optional<KeyPair> key_pair_of(const std::array<std::uint8_t, 32>& private_key) {
  const Group group = p256();
  const Number scalar = number_of(private_key);
  if (!group || !scalar || BN_is_zero(scalar.get()) ||
      BN_cmp(scalar.get(), EC_GROUP_get0_order(group.get())) >= 0)
    return std::nullopt;
  const Point point(EC_POINT_new(group.get()));
  const Number x(BN_new());
  const Number y(BN_new());
  KeyPair pair{private_key, {}};
  const std::span<std::uint8_t> octets(pair.public_key);
  const bool is_made =
      point && x && y &&
      EC_POINT_mul(group.get(), point.get(), scalar.get(), nullptr, nullptr, nullptr) == 1 &&
      EC_POINT_get_affine_coordinates(group.get(), point.get(), x.get(), y.get(), nullptr) == 1 &&
      write_number(x.get(), octets.first(coordinate_bytes)) &&
      write_number(y.get(), octets.last(coordinate_bytes));
  return is_made ? std::optional(pair) : std::nullopt;
}

std::optional<SharedSecret> shared_secret(const KeyPair& own, const PublicKey& peer) {
  const Group group = p256();
  const Number scalar = number_of(own.private_key);
  const ByteView octets(peer);
  const Number peer_x = number_of(octets.first(coordinate_bytes));
  const Number peer_y = number_of(octets.last(coordinate_bytes));
  const Point peer_point(group ? EC_POINT_new(group.get()) : nullptr);
  const Point common(group ? EC_POINT_new(group.get()) : nullptr);
  const Number x(BN_new());
  if (!scalar || !peer_x || !peer_y || !peer_point || !common || !x) return std::nullopt;
  SharedSecret secret;
  // Setting the coordinates fails for a point that is not on the curve.
  const bool is_made =
      EC_POINT_set_affine_coordinates(group.get(), peer_point.get(), peer_x.get(), peer_y.get(),
                                      nullptr) == 1 &&
      EC_POINT_mul(group.get(), common.get(), nullptr, peer_point.get(), scalar.get(), nullptr) ==
          1 &&
      EC_POINT_get_affine_coordinates(group.get(), common.get(), x.get(), nullptr, nullptr) == 1 &&
      write_number(x.get(), secret);
  return is_made ? std::optional(secret) : std::nullopt;
}

namespace {

constexpr std::uint8_t static_method = 1;
constexpr std::uint8_t closed_in_success = 0;
constexpr std::uint8_t closed_by_timeout = 1;
constexpr std::size_t max_commands = 4;
constexpr const char* key_was_lost =
    "it has taken its address, but its device key was lost on the serial line";

/// Mesh Profile 1.0 table 5.38.
std::string_view error_text(std::uint8_t error) {
  constexpr std::array<std::string_view, 9> texts{"prohibited",
                                                  "invalid PDU",
                                                  "invalid format",
                                                  "unexpected PDU",
                                                  "confirmation failed: is the device's static "
                                                  "OOB ble_mesh.provisioning.static_oob?",
                                                  "the device is out of resources",
                                                  "decryption failed",
                                                  "unexpected error",
                                                  "the device can't take these addresses"};
  return error < texts.size() ? texts[error] : "unlisted error";
}

}  // namespace

ProvisioningSession::ProvisioningSession(const ProvisionDevice& device, const KeyPair& key_pair,
                                         std::uint8_t context, const StartedBoard& board,
                                         ActionQueue<RadioAction>& actions, TimePoint now)
    : key_pair_(key_pair),
      actions_(actions),
      context_(context),
      dropped_before_(board.dropped_events.value_or(0)),
      static_oob_(device.static_oob),
      due_(now + wait_limit) {
  commands_.push_back(
      encode_command(CommandOpcode::keypair_set, key_pair.private_key, key_pair.public_key));
  commands_.push_back(encode_capabilities_set());
  commands_.push_back(encode_provision(context, device, board.version));
}

std::optional<Bytes> ProvisioningSession::command() const {
  if (state_ != State::running || commands_.empty()) return std::nullopt;
  return commands_.front();
}

void ProvisioningSession::on_response(const CommandResponse& response, bool is_repeat) {
  if (state_ != State::running || commands_.empty()) return;
  commands_.pop_front();
  if (response.opcode == static_cast<std::uint8_t>(CommandOpcode::housekeeping_get)) {
    ByteReader data(response.data);
    const std::uint32_t dropped = data.read_u32_le();
    if (data.ok())
      end_.remark =
          fmt::format("; the serial board has dropped {} event(s) since it was started up",
                      dropped - std::min(dropped, dropped_before_));
    return fail(key_was_lost);
  }
  // The board obeyed the first copy, but its answer was lost.
  const bool was_done = is_repeat && response.status == Status::invalid_state;
  if (response.status == Status::success || was_done) return;
  if (response.opcode == static_cast<std::uint8_t>(CommandOpcode::provision) &&
      response.status == Status::invalid_state) {
    is_context_busy_ = true;
    return fail(
        "the serial board is still busy with earlier provisioning links, which end by themselves "
        "within a minute");
  }
  fail(fmt::format("the serial board answers \"{}\" (0x{:02x}) to command 0x{:02x}",
                   to_string(response.status), static_cast<unsigned>(response.status),
                   response.opcode));
}

void ProvisioningSession::on_event(const ProvisioningEvent& event, TimePoint now) {
  if (state_ != State::running) return;
  std::visit(
      [&](const auto& what) {
        if constexpr (requires { what.context; })
          if (what.context == context_) on(what, now);
      },
      event);
}

void ProvisioningSession::on(const ProvisioningLinkOpened&, TimePoint now) {
  if (stage_ == Stage::opening) enter(Stage::awaiting_capabilities, now);
}

void ProvisioningSession::on(const CapabilitiesReceived& event, TimePoint now) {
  if (stage_ > Stage::awaiting_capabilities) return;
  if (event.elements == 0) return fail("the device says that it has no element");
  offers_static_oob_ = (event.static_oob_types & 1) != 0;
  actions_.push(DeviceAnswered{event.elements});
  enter(Stage::awaiting_addresses, now);
}

/// Takes the static method also with a device that has no value: it fails, and its link ends at
/// once. Left alone, the link would hold the board for a minute.
void ProvisioningSession::on_addresses(TimePoint now) {
  if (!wants_addresses()) return;
  commands_.push_back(
      encode_oob_use(context_, static_oob_ ? OobMethod::static_data : OobMethod::none));
  enter(Stage::exchanging, now);
}

void ProvisioningSession::on(const AuthenticationRequested& event, TimePoint now) {
  if (stage_ != Stage::exchanging && stage_ != Stage::completing) return;
  if (event.method == 0) return;
  if (event.method != static_method || !static_oob_)
    return fail(fmt::format("the serial board asks for OOB method {}", event.method));
  if (commands_.size() >= max_commands) return;
  commands_.push_back(encode_command(CommandOpcode::auth_data, context_, *static_oob_));
  enter(stage_, now);
}

void ProvisioningSession::on(const EcdhRequested& event, TimePoint now) {
  if (stage_ != Stage::exchanging) return;
  const auto secret = shared_secret(key_pair_, event.peer);
  if (!secret) return fail("the device's public key is not on the curve");
  if (commands_.size() >= max_commands) return;
  commands_.push_back(encode_command(CommandOpcode::ecdh_secret, context_, *secret));
  enter(Stage::completing, now);
}

void ProvisioningSession::on(const ProvisioningComplete& event, TimePoint now) {
  if (stage_ != Stage::completing) return;
  actions_.push(DeviceJoined{event.device_key});
  enter(Stage::closing, now);
}

void ProvisioningSession::on(const ProvisioningLinkClosed& event, TimePoint now) {
  if (stage_ == Stage::closing) {
    state_ = State::succeeded;
  } else if (event.reason == closed_by_timeout) {
    on_link_lost("the provisioning link ended: time-out");
  } else if (event.reason == closed_in_success && stage_ == Stage::completing) {
    end_.is_key_lost = end_.may_have_joined = true;  // the board reports the key once
    commands_.push_back(encode_command(CommandOpcode::housekeeping_get));
    enter(Stage::counting, now);
  } else {
    fail(event.reason == closed_in_success ? "the provisioning link ended early"
                                           : "the provisioning link ended: failed");
  }
}

void ProvisioningSession::on(const ProvisioningFailed& event, TimePoint) {
  if (stage_ == Stage::closing) return;
  if (static_oob_ && !offers_static_oob_) return fail(lacks_static_oob);
  const bool may_need_oob = offers_static_oob_ && !static_oob_;
  fail(fmt::format("{} (0x{:02x}){}", error_text(event.error), event.error,
                   may_need_oob ? "; the device has static OOB data, and "
                                  "ble_mesh.provisioning.static_oob is not set"
                                : ""));
}

std::optional<TimePoint> ProvisioningSession::deadline() const {
  return state_ == State::running ? std::optional(due_) : std::nullopt;
}

void ProvisioningSession::on_deadline(TimePoint now) {
  if (state_ != State::running || now < due_) return;
  switch (stage_) {
    case Stage::opening: return fail("the device opens no provisioning link");
    case Stage::awaiting_capabilities: return fail("the device does not answer the invitation");
    case Stage::awaiting_addresses: return fail("its addresses could not be stored");
    case Stage::exchanging:
    case Stage::completing: return on_link_lost("the exchange of keys did not end");
    case Stage::counting: return fail(key_was_lost);
    case Stage::closing: state_ = State::succeeded; return;
  }
}

void ProvisioningSession::enter(Stage stage, TimePoint now) {
  stage_ = stage;
  const bool is_ending = stage == Stage::closing || stage == Stage::counting;
  due_ = now + (is_ending ? close_limit : wait_limit);
}

void ProvisioningSession::on_link_lost(std::string why) {
  if (stage_ == Stage::completing) {
    end_.may_have_joined = true;
    why += "; if the device took its address nevertheless, it has to be reset by hand";
  }
  fail(std::move(why));
}

void ProvisioningSession::fail(std::string why) {
  state_ = State::failed;
  if (stage_ != Stage::closing) end_.failure = std::move(why);
}

}  // namespace slamgw::ble

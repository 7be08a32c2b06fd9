// SPDX-License-Identifier: Apache-2.0
// The link to one serial board. It gets in step with the board (finds the frame borders), starts it
// up, and keeps one command in flight. Whenever something is lost, it starts again from the
// beginning. It does not read robots' messages, and BoardRadio chooses the commands to a started
// board. Called by BoardRadio, which drains its actions.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <random>
#include <set>
#include <string>
#include <variant>

#include "adapters/ble_mesh_usb_cdc/nordic/serial_protocol.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/start_up.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/log_throttle.hpp"
#include "daemon/core/protocol_machine.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

/// Decides whether an open serial line is usable: counts its faults and names the likely cause. The
/// line has no checksum. So lost or added octets show only as torn frames, refusals of commands
/// that were never sent, and missing answers. Called by BoardLink.
class LineHealth {
 public:
  /// Losses in a row after which the link gives the line up.
  static constexpr int max_losses = 8;
  /// Losses in a row from which a warning is logged.
  static constexpr int noticeable_losses = 3;
  /// A loss that comes later than this after the last one begins a new row.
  static constexpr Duration stable_time = std::chrono::seconds{10};
  /// Unanswered commands with one opcode in a row after which the link gives the line up.
  static constexpr int max_timeouts = 3;

  /// Octets were lost or added: a frame was torn, or the board did not understand a command.
  void on_lost_step(TimePoint now);
  void on_timeout(std::uint8_t opcode, TimePoint now);
  /// A command was answered.
  void on_answer(std::uint8_t opcode);

  int losses() const { return losses_; }
  /// Returns why the port should be closed; nothing while the line is usable.
  std::optional<std::string> verdict() const;
  /// Returns when the line counts as good again, if no further loss comes.
  TimePoint stable_at() const { return last_loss_ + stable_time; }

 private:
  void count(TimePoint now);

  int losses_ = 0;
  bool has_lost_step_ = false;  ///< since the port was opened
  TimePoint last_loss_{};
  std::uint8_t silent_opcode_ = 0;  ///< of the last command that was not answered
  int timeouts_ = 0;                ///< of `silent_opcode_`, in a row
};

/// Finds the frame borders again, in any state of the board. 255 zero octets complete any torn
/// command. Then an Echo with a fresh nonce proves that a board with Nordic's serial firmware is
/// there, and marks the border in its answers. Every connection starts this way, too. Called by
/// BoardLink, which drops all other octets until then.
class Resync {
 public:
  static constexpr Duration quiet_time = std::chrono::milliseconds{300};
  /// On a busy mesh the board is never quiet; the nonce alone then has to find the border.
  static constexpr Duration max_wait_for_quiet = std::chrono::seconds{1};
  /// Time limit of each attempt. A board that was just reset may be silent for seconds, or answer
  /// late.
  static constexpr std::array<Duration, 5> echo_time_limits{
      std::chrono::milliseconds{500}, std::chrono::seconds{2}, std::chrono::seconds{2},
      std::chrono::seconds{2}, std::chrono::seconds{2}};

  enum class State : std::uint8_t { idle, awaiting_quiet, awaiting_echo, in_step, failed };

  explicit Resync(std::uint64_t seed) : random_(seed) {}

  /// Forgets an earlier attempt. Returns the octets to write.
  Bytes start(TimePoint now);
  /// Returns the octets after the border once it is found; empty until then.
  ByteView on_bytes(ByteView bytes, TimePoint now);
  std::optional<TimePoint> deadline() const;
  /// Returns octets to write, if any.
  std::optional<Bytes> on_deadline(TimePoint now);

  State state() const { return state_; }
  /// Returns the number of octets since `start`; 0 means that no board answers.
  std::size_t octets_seen() const { return octets_seen_; }
  /// Returns true if a zero was refused as only Nordic's firmware does. Then that firmware is
  /// there, even without an Echo.
  bool has_seen_refusal() const { return has_seen_refusal_; }

 private:
  bool is_waiting() const {
    return state_ == State::awaiting_quiet || state_ == State::awaiting_echo;
  }
  Bytes flush(TimePoint now);

  std::mt19937_64 random_;
  State state_ = State::idle;
  std::size_t attempts_ = 0;
  std::size_t octets_seen_ = 0;
  std::uint32_t last_octets_ = 0;  ///< the last four received
  bool has_seen_refusal_ = false;
  TimePoint due_{};
  TimePoint quiet_limit_{};
  Bytes awaited_;  ///< the Echo's answer as it comes over the wire
  Bytes tail_;     ///< the last octets received, fewer than `awaited_`
};

/// The answer to the radio's command will not come.
struct AnswerLost {};

/// StartedBoard comes each time when the board was started up, before LinkIsUp if the link was
/// down. CommandResponse answers the radio's command.
using LinkAction = std::variant<WriteSerial, ReopenPort, KeysWanted, SourceWanted, StartedBoard,
                                LinkIsUp, LinkIsDown, CommandResponse, AnswerLost, MessageReceived,
                                Heartbeat, IvUpdate, ProvisioningEvent, RadioCleared, Notice>;

struct LinkCounters {
  std::uint64_t resyncs = 0;   ///< attempts to get in step, the first after opening included
  std::uint64_t restarts = 0;  ///< the board's own
  std::uint64_t command_timeouts = 0;
  std::uint64_t malformed_events = 0;
  std::uint64_t other_events = 0;  ///< not used here, whether the protocol has them or not
  std::uint64_t board_drops = 0;   ///< events lost inside the board (command 0x14)
  std::uint64_t tx_complete = 0;
};

class BoardLink {
 public:
  static constexpr Duration command_time_limit = std::chrono::seconds{2};
  /// Interval of polls, which ask in turn for dropped events and for the board's address.
  static constexpr Duration poll_interval = std::chrono::seconds{10};
  static constexpr Duration first_reopen_delay = std::chrono::milliseconds{500};
  static constexpr Duration max_reopen_delay = std::chrono::seconds{5};
  /// Longest delay for a line that loses octets, because each attempt costs a start-up.
  static constexpr Duration max_unusable_delay = std::chrono::seconds{60};
  /// A board that is busy during start-up, for example writing its flash, is asked again after
  /// this.
  static constexpr Duration busy_pause = std::chrono::milliseconds{200};
  static constexpr int max_busy_answers = 25;
  /// A board that must not be used is checked again at this interval. A board that seems to have
  /// lost its address is checked at most this often.
  static constexpr Duration refusal_interval = std::chrono::seconds{30};
  /// The shortest interval of those checks after a board had lost its address indeed.
  static constexpr Duration confirmed_interval = std::chrono::seconds{3};
  /// Maximum of different notices while the link is down. Further ones are dropped.
  static constexpr std::size_t max_notified = 16;

  /// `seed` makes the Echo nonces.
  BoardLink(Settings settings, std::optional<RadioKeys> keys, std::uint64_t seed);

  void on_port_open(TimePoint now);
  void on_port_closed(const std::string& why, TimePoint now);
  void on_bytes(ByteView bytes, TimePoint now);
  void on_keys_failed(const std::string& why, TimePoint now);
  /// Takes the address to send from, which is on disk. `count` is the number of addresses for a
  /// board that has none.
  void on_source(std::uint16_t source, std::uint16_t count, TimePoint now);
  /// The address to send from is not on disk yet.
  void on_source_delayed(const std::string& why);

  bool is_up() const { return is_up_; }
  /// Returns true if the board waits for a command.
  bool is_ready() const { return stage_ == Stage::running && !in_flight_; }
  /// Sends one complete command of the radio. Call only if the link is ready. The command ends with
  /// CommandResponse, AnswerLost or LinkIsDown.
  void send(Bytes command, TimePoint now) { issue(std::move(command), Issuer::radio, now); }
  /// Sends State Clear: the board forgets keys, addresses and sequence numbers and is started up
  /// again. Call only on an operator's order. Returns false if no board can be cleared now.
  bool clear_board(TimePoint now);
  /// Starts the board up with the mesh's new or changed keys. A board that has the former keys is
  /// cleared.
  void change_keys(const RadioKeys& keys, TimePoint now);

  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);
  std::optional<LinkAction> next_action() { return actions_.pop(); }
  const LinkCounters& counters() const { return counters_; }

 private:
  enum class Stage : std::uint8_t { closed, resyncing, starting, running, refused };
  /// The issuer of the command in flight.
  enum class Issuer : std::uint8_t { start_up, poll, clear, radio };

  struct InFlight {
    std::uint8_t opcode = 0;
    TimePoint deadline{};
    Issuer issuer = Issuer::start_up;
  };

  /// Returns true while the start-up waits for this.
  bool awaits(StartUp::State what) const {
    return stage_ == Stage::starting && start_up_->state() == what;
  }
  void begin_resync(TimePoint now);
  void begin_start_up(TimePoint now);
  void continue_start_up(TimePoint now);
  void on_keys_needed(TimePoint now);
  void on_source_needed(TimePoint now);
  void on_started(TimePoint now);
  void on_frame(const Bytes& frame, TimePoint now);
  void on_event(DeviceStarted& event, TimePoint now);
  void on_event(CommandResponse& event, TimePoint now);
  void on_response(CommandResponse& response, Issuer issuer, TimePoint now);
  void on_board_cleared(Status status, TimePoint now);
  void on_polled(const CommandResponse& response, TimePoint now);
  void on_drop_counter(std::uint32_t total, TimePoint now);
  void on_address_lost(TimePoint now);
  void on_command_timeout(TimePoint now);
  void on_refused(TimePoint now);
  void refuse(const std::string& why, TimePoint now);
  void on_lost_step(TimePoint now);
  void get_in_step_again(TimePoint now);

  void issue(Bytes command, Issuer issuer, TimePoint now);
  void send_next(TimePoint now);
  void issue_clear(TimePoint now);
  void on_silence();
  void give_up(const std::string& why, Duration max_delay);
  void go_down(const std::string& why);
  void notify_once(Severity severity, const std::string& text);
  void warn(std::string text) { actions_.push(Notice{Severity::warning, std::move(text), {}}); }

  Settings settings_;
  std::optional<RadioKeys> keys_;
  ActionQueue<LinkAction> actions_;
  Stage stage_ = Stage::closed;
  bool is_up_ = false;
  std::string down_reason_;
  std::set<std::string> notified_;  ///< notices since the link last went down
  FrameDecoder decoder_;
  Resync resync_;
  std::optional<StartUp> start_up_;
  std::optional<InFlight> in_flight_;
  LineHealth health_;
  std::optional<TimePoint> busy_until_;  ///< while starting
  int busy_answers_ = 0;
  std::string unconfirmed_refusal_;
  Duration reopen_delay_ = first_reopen_delay;
  TimePoint retry_at_{};  ///< while refused
  TimePoint poll_at_{};   ///< while running
  bool is_address_polled_next_ = false;
  TimePoint not_suspected_until_ = TimePoint::min();
  bool is_clear_wanted_ = false;
  bool was_cleared_ = false;    ///< since the last start-up
  bool has_restarted_ = false;  ///< while the link was up; since the last start-up
  std::optional<std::uint32_t> dropped_events_;
  LogThrottle drop_throttle_;
  LogThrottle loss_throttle_{std::chrono::minutes{1}};
  LogThrottle malformed_throttle_;
  LinkCounters counters_;
};

}  // namespace slamgw::ble

// SPDX-License-Identifier: Apache-2.0
// Connects the broker with the open pages: each message goes to all pages, each command to the
// broker. Keeps the newest states for later pages. On the loop's thread; owns no socket.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/thread_pool.hpp>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>

#include "daemon/config/config.hpp"
#include "daemon/runtime/timer.hpp"
#include "web/server/history.hpp"
#include "web/server/io/broker_link.hpp"
#include "web/server/last_known.hpp"
#include "web/server/metrics.hpp"
#include "web/server/page_session.hpp"
#include "web/server/past.hpp"
#include "web/server/places.hpp"
#include "web/server/roster.hpp"
#include "web/server/topics.hpp"

namespace slamgw::web {

class PageConnection;

class PageHub {
 public:
  /// Each page costs a copy of all traffic on the wire. A lab has a handful.
  static constexpr std::size_t max_pages = 32;
  /// The period in which the states of gateways and robots are decided.
  static constexpr std::chrono::milliseconds roster_period{250};

  PageHub(boost::asio::io_context& io, const Config& config, Tokens tokens, std::string version);

  /// Places for pages. A place is taken at a page's request, so that simultaneous requests count.
  Places& places() { return places_; }
  /// Returns the greeting for a page that has to send a token first.
  static std::string locked_greeting();
  /// Sends the page all known states, then each message as it comes, until leave().
  void join(PageConnection& page);
  void leave(PageConnection& page);
  /// Returns the topics and texts for a page that has seen everything up to `since_ms`.
  std::vector<std::pair<std::string, SharedText>> past(std::int64_t since_ms) const;
  SharedText history_of(const std::string& robot) const;
  PageSession new_session(Client client) { return {topics_, tokens_, guesses_, std::move(client)}; }
  const Tokens& tokens() const { return tokens_; }
  TokenGuesses& guesses() { return guesses_; }
  /// Sends the command to the broker. Returns a refusal for the page, or nothing if it was sent.
  std::string publish(const CommandRequest& command);

  void count_refused_request() { ++own_.requests_refused; }
  void count_dropped(std::uint64_t messages) { own_.messages_dropped += messages; }
  /// Logs one line, and the next only after a minute without such a refusal of this client.
  void report_taken_share(const Client& client);

  /// The most scrapes under way: their metrics are being made, or are not read yet. Prometheus uses
  /// one connection; with many robots, the text has megabytes.
  static constexpr unsigned max_scrapes = 2;
  /// Returns a place to hold from the request to the end of the answer. Null when there are too
  /// many scrapes.
  std::shared_ptr<void> begin_scrape();
  /// Makes metrics one after the other on a separate thread, because that reads thousands of
  /// documents. Calls `done`, which holds a place, on the loop.
  void make_metrics(std::function<void(std::string)> done);
  /// Call before the loop destroys its operations: ends the thread, which posts to the loop.
  void end() { metrics_thread_.join(); }

 private:
  void on_message(const BrokerMessage& message);
  void on_broker(bool is_up, const std::string& why);
  void on_refused(std::uint64_t command, const std::string& why);
  void on_unreadable(const std::string& filter, const std::string& why);
  void send_broker_state();
  /// Returns whether pages get the message: false if there is no room, or if it withdraws an
  /// unknown state.
  bool keep(const BrokerMessage& message, const SharedText& text);
  void on_robot_message(const BrokerMessage& message);
  void pass_to_roster(const BrokerMessage& message);
  void update_roster();
  void reset_pages();
  std::string greeting() const;
  std::string broker_state() const;

  const Topics topics_;
  const Tokens tokens_;
  std::string site_;    ///< JSON members of the greeting: gateway, prefix, origins, version
  std::string broker_;  ///< the broker's URIs
  std::string why_ = "connecting";
  bool was_connected_ = false;
  std::map<std::string, std::string> unreadable_;  ///< filters that the broker refuses, and why
  LastKnown known_;
  Roster roster_;
  History history_;
  Past past_;
  OutcomeCounts outcomes_;
  OwnNumbers own_;
  Places places_{max_pages};
  TokenGuesses guesses_;
  ClientCounts taken_shares_;  ///< refusals because the client already has its share
  std::set<PageConnection*> pages_;
  std::deque<std::pair<std::uint64_t, std::string>> sent_;        ///< topics of the newest commands
  const std::shared_ptr<void> scrape_ = std::make_shared<int>();  ///< each scrape holds a copy
  boost::asio::io_context& io_;
  Timer roster_timer_;
  BrokerLink link_;
  boost::asio::thread_pool metrics_thread_{1};
};

}  // namespace slamgw::web

// SPDX-License-Identifier: Apache-2.0
// What stands between the broker and the open pages: each message goes to all of them, each
// command to the broker; the newest states are kept for pages that come later. On the loop's
// thread; owns no socket.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/thread_pool.hpp>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>

#include "daemon/config/config.hpp"
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
  /// How often the states of gateways and robots are decided.
  static constexpr std::chrono::milliseconds roster_period{250};

  PageHub(boost::asio::io_context& io, const Config& config, Tokens tokens, std::string version);

  /// Taken from a page's request on, so that many at once do not pass together.
  Places& places() { return places_; }
  /// For a page that has to send a token first.
  static std::string locked_greeting();
  /// The page gets what is known; then everything as it comes, until leave().
  void join(PageConnection& page);
  void leave(PageConnection& page);
  /// For the page that asked.
  std::vector<std::pair<std::string, SharedText>> past(std::int64_t since_ms) const;
  SharedText history_of(const std::string& robot) const;
  PageSession new_session(Client client) { return {topics_, tokens_, guesses_, std::move(client)}; }
  const Tokens& tokens() const { return tokens_; }
  TokenGuesses& guesses() { return guesses_; }
  /// What could not be sent to the broker, for the page that wanted it; empty when it was.
  std::string publish(const CommandRequest& command);

  void count_refused_request() { ++own_.requests_refused; }
  /// One line of the log until a minute has passed without another of this client.
  void report_taken_share(const Client& client);

  /// Metrics that are made, or wait until somebody has read them. Prometheus asks with one
  /// connection; of many robots the text has megabytes.
  static constexpr unsigned max_scrapes = 2;
  /// Held from the question to the end of the answer, or until its client is gone; null when too
  /// many ask.
  std::shared_ptr<void> begin_scrape();
  /// Reads thousands of documents, so on a thread of its own, one after the other; `done` comes on
  /// the loop. Those whose `place` is free again are not made.
  void make_metrics(std::weak_ptr<void> place, std::function<void(std::string)> done);
  /// Before the loop drops what waits: then nothing comes to it any more, and no client waits here.
  void end() {
    metrics_thread_.join();
    waiting_scrapes_.clear();
  }

 private:
  struct Scrape {
    std::weak_ptr<void> place;
    std::function<void(std::string)> done;
  };
  void make_next_metrics();
  void on_message(const BrokerMessage& message);
  void on_broker(bool is_up, const std::string& why);
  void on_refused(std::uint64_t command, const std::string& why);
  void on_unreadable(const std::string& filter, const std::string& why);
  void send_broker_state();
  /// Whether pages get it: false where there is no room, or when it withdraws what was not known.
  bool keep(const BrokerMessage& message, const SharedText& text);
  void on_robot_message(const BrokerMessage& message);
  void tell_roster(const BrokerMessage& message);
  void update_roster();
  void update_roster_later();
  void reset_pages();
  std::string greeting() const;
  std::string broker_state() const;

  const Topics topics_;
  const Tokens tokens_;
  std::string site_;    ///< JSON members of the greeting: gateway's prefix, origins, version
  std::string broker_;  ///< its URI
  std::string why_ = "connecting";
  bool was_connected_ = false;
  std::map<std::string, std::string> unreadable_;  ///< filters that the broker refuses: why
  LastKnown known_;
  Roster roster_;
  History history_;
  Past past_;
  OutcomeCounts outcomes_;
  OwnNumbers own_;
  std::uint64_t dropped_by_gone_ = 0;
  Places places_{max_pages};
  TokenGuesses guesses_;
  ClientCounts taken_shares_;  ///< what was refused because its client has its share
  std::set<PageConnection*> pages_;
  std::deque<std::pair<std::uint64_t, std::string>> sent_;  ///< topics of the newest commands
  std::shared_ptr<unsigned> scrapes_ = std::make_shared<unsigned>(0);
  std::deque<Scrape> waiting_scrapes_;  ///< bounded by max_scrapes
  bool is_making_metrics_ = false;
  boost::asio::io_context& io_;
  boost::asio::steady_timer roster_timer_;
  BrokerLink link_;
  boost::asio::thread_pool metrics_thread_{1};
};

}  // namespace slamgw::web

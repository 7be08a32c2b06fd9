// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/io/mqttsn_adapter.hpp"

#include <fmt/format.h>
#include <net/if.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <random>
#include <stdexcept>
#include <utility>

namespace slamgw::mqttsn {
namespace {

namespace asio = boost::asio;

/// Delay of a check after the kernel reports a change of an interface: more changes follow.
constexpr std::chrono::milliseconds change_settles{100};
/// Interval of checks without a report: the kernel may report nothing, or drop a report.
constexpr std::chrono::seconds watch_interval{10};
/// Returns `, [::]:47193`, with the port that the kernel has chosen.
std::string place_of(const char* before, const std::string& listen, const UdpSocket& socket) {
  return fmt::format("{}{}:{}", before, listen.substr(0, listen.rfind(':')), socket.port());
}

constexpr const char* interface_advice =
    ": the Thread border router creates it; see systemctl status otbr-agent (older: wpantund), or "
    "set mqttsn.interface";
constexpr const char* open_to_all =
    "MQTT-SN serves every network of this host, because mqttsn.interface is \"*\": any host that "
    "reaches its port can act as any robot; \"auto\" serves Thread and loopback only";

}  // namespace

MqttsnAdapter::MqttsnAdapter(asio::io_context& io, Settings settings, TopicPolicy policy,
                             RobotNames names, MeshListener& listener, SessionStore* sessions,
                             DescriptorStore* descriptors, RobotKeys keys)
    : settings_(std::move(settings)),
      listener_(listener),
      descriptors_(descriptors),
      announced_name_("slam-gateway " + policy.scheme().gateway_id()),
      io_(io),
      gateway_(settings_, std::move(policy), std::move(names),
               [device = std::make_shared<std::random_device>()] {
                 return static_cast<std::uint16_t>((*device)());
               }),
      driver_(
          io, gateway_,
          [this](Action& action) { std::visit([this](auto& what) { perform(what); }, action); },
          [this] {
            if (keeper_) keeper_->save_soon();  // each input may have changed sessions
          }),
      interface_watch_(std::make_shared<InterfaceWatch>(io)),
      watch_timer_(io) {
  gateway_.use_identities(identities_of(keys));
  if (settings_.dtls.keys_file)
    dtls_ = std::make_unique<DtlsPort>(
        io, std::move(keys), std::bind_front(&MqttsnAdapter::on_decrypted, this),
        [this](Notice notice) { listener_.on_mesh_event(std::move(notice)); });
  if (settings_.announce)
    announcement_.emplace(io, std::string(),
                          [this](Notice notice) { listener_.on_mesh_event(std::move(notice)); });
  if (sessions)
    keeper_.emplace(io, gateway_, *sessions,
                    [this](bool is_saved) { driver_->on_saved(is_saved, read_clocks()); });
}

void MqttsnAdapter::start() {
  if (auto restored = keeper_ ? keeper_->restore(read_clocks().mono) : std::nullopt)
    listener_.on_mesh_event(std::move(*restored));
  interfaces_ = read_network_interfaces();
  interface_index_ = index_of_interface();
  only_thread_ = thread_interfaces();
  if (settings_.is_open_to_all())
    listener_.on_mesh_event(Notice{Severity::warning, open_to_all, {}});
  if (!settings_.names_interface() || interface_index_ != 0) {
    open();
  } else {
    report_link(false, "there is no interface " + settings_.interface + " yet" + interface_advice);
  }
  interface_watch_->start([this] { check_interfaces_in(change_settles); });
  watch_interfaces();
  driver_.perform_actions();  // of restored sessions
}

void MqttsnAdapter::stop_listening() {
  if (announcement_) announcement_->withdraw();
  for (const auto& socket : all_sockets()) socket->stop_receiving();
  MeshShell::stop_listening();
}

/// Plain clients get no goodbye, and the sockets stay open to the very end, so that they notice
/// nothing of a restart. A DTLS connection cannot outlive the daemon.
void MqttsnAdapter::stop() {
  driver_->send_unsaved();  // the keeper saves all
  driver_.stop();
  if (dtls_) dtls_->end_connections();
  for (const auto& socket : all_sockets()) socket->flush();
  if (keeper_) keeper_->stop();
  interface_watch_->stop();
  watch_timer_.cancel();
}

void MqttsnAdapter::open() {
  std::vector<int> kept = take_kept(settings_.listen);
  std::vector<int> kept_dtls = dtls_ ? take_kept(settings_.dtls.listen) : std::vector<int>();
  if (descriptors_) descriptors_->drop_rest();  // they may hold the ports that are bound next
  where_.clear();
  for (std::size_t i = 0; i < settings_.listen.size(); ++i) {
    const std::string& listen = settings_.listen[i];
    sockets_.push_back(open_socket(listen, std::exchange(kept[i], -1), "mqttsn.listen"));
    sockets_.back()->start(std::bind_front(&MqttsnAdapter::on_datagram, this),
                           static_cast<std::uint8_t>(i));
    where_ += place_of(where_.empty() ? "UDP " : ", ", listen, *sockets_.back());
  }
  for (std::size_t i = 0; i < kept_dtls.size(); ++i) {
    const std::string& listen = settings_.dtls.listen[i];
    dtls_->add(open_socket(listen, std::exchange(kept_dtls[i], -1), "mqttsn.dtls.listen"));
    where_ += place_of(i == 0 ? ", DTLS " : ", ", listen, *dtls_->sockets().back());
  }
  report_open();
  if (announcement_) announce_on_lan();
}

/// One of the addresses is a wildcard: without one, the configuration is refused.
void MqttsnAdapter::announce_on_lan() {
  const auto is_ipv4 = [](const std::string& listen) { return !listen.starts_with('['); };
  const auto wide = std::ranges::find_if(settings_.listen, Settings::is_wildcard);
  const auto index = static_cast<std::size_t>(wide - settings_.listen.begin());
  announcement_->announce({announced_name_, sockets_[index]->port(),
                           static_cast<int>(interface_index_), is_ipv4(*wide)});
}

void MqttsnAdapter::report_open() {
  std::string detail = where_;
  if (!only_thread_.empty()) {
    detail += fmt::format(", only from {} and loopback", only_thread_);
  } else if (settings_.is_auto() && settings_.listens_widely()) {
    detail += ", from all networks";
  }
  report_link(true, std::move(detail));
}

std::vector<int> MqttsnAdapter::take_kept(const std::vector<std::string>& listen) {
  std::vector<int> kept(listen.size(), -1);
  for (std::size_t i = 0; descriptors_ && i < listen.size(); ++i)
    kept[i] = descriptors_->take(kept_name(listen[i]));
  return kept;
}

std::shared_ptr<UdpSocket> MqttsnAdapter::open_socket(const std::string& listen, int kept,
                                                      const char* key) {
  auto socket = std::make_shared<UdpSocket>(io_, listen, bound_to(), kept, key);
  if (descriptors_ && !socket->is_taken_over())
    descriptors_->keep(kept_name(listen), socket->descriptor());
  return socket;
}

void MqttsnAdapter::close() {
  if (announcement_) announcement_->withdraw();
  for (const auto& socket : all_sockets()) {
    socket->close();
    counts_ += socket->counts();
  }
  sockets_.clear();
  if (dtls_) dtls_->forget_sockets();
  for (const std::vector<std::string>& addresses : {settings_.listen, settings_.dtls.listen})
    for (const std::string& listen : addresses)
      if (descriptors_) descriptors_->drop(kept_name(listen));
}

/// Returns all sockets; those for DTLS come last.
std::vector<std::shared_ptr<UdpSocket>> MqttsnAdapter::all_sockets() const {
  std::vector<std::shared_ptr<UdpSocket>> all = sockets_;
  if (dtls_) all.insert(all.end(), dtls_->sockets().begin(), dtls_->sockets().end());
  return all;
}

/// The name contains all that a kept socket must fit, because only this daemon stores sockets under
/// it. systemd allows no colons.
std::string MqttsnAdapter::kept_name(const std::string& listen) const {
  std::string name =
      fmt::format("mqttsn,{},{},{}", listen, bound_to(), settings_.multicast_group.value_or(""));
  std::replace(name.begin(), name.end(), ':', '.');
  return name;
}

void MqttsnAdapter::on_session_held(const std::string& robot) { driver_->on_session_held(robot); }

std::vector<WaitingMessage> MqttsnAdapter::give_up(const std::string& robot) {
  return driver_->give_up(robot, read_clocks());
}

void MqttsnAdapter::forget(const std::string& robot) { driver_->forget(robot, read_clocks()); }

void MqttsnAdapter::on_note(const std::string& robot, std::optional<ByteView> note) {
  driver_->on_note(robot, note, read_clocks());
}

void MqttsnAdapter::reconfigure(TopicPolicy policy, RobotNames names, RobotKeys keys) {
  driver_->reconfigure(std::move(policy), std::move(names), identities_of(keys), read_clocks());
  if (dtls_) dtls_->use_keys(std::move(keys));
}

void MqttsnAdapter::ping(const std::string& robot, OrderDone done) {
  pings_.emplace(++last_ping_, std::move(done));
  driver_->ping(last_ping_, robot, read_clocks().mono);
}

void MqttsnAdapter::perform(PingEnded& ended) {
  const auto waiting = pings_.extract(ended.id);
  if (waiting) waiting.mapped()(std::move(ended.answer));
}

nlohmann::json MqttsnAdapter::report(const std::optional<std::string>& robot) const {
  return gateway_.report(robot, read_clocks().mono);
}

Counters MqttsnAdapter::counters() const {
  Counters counters = gateway_.counters();
  UdpSocket::Counts counts = counts_;
  for (const auto& socket : all_sockets()) counts += socket->counts();
  counters.push_back({"kernel_drops", counts.kernel_drops});
  counters.push_back({"truncated", counts.truncated});
  counters.push_back({"from_unserved_networks", unserved_});
  counters.push_back({"sends_failed", counts.sends_failed});
  if (dtls_)
    for (const auto& counter : dtls_->counters()) counters.push_back(counter);
  return counters;
}

void MqttsnAdapter::on_datagram(const UdpSocket::Datagram& datagram) {
  LocalAddress to = datagram.to;
  const bool is_asked_for = !Settings::is_wildcard(settings_.listen[to.socket]);
  if (!is_asked_for && !is_served(to.interface)) return drop_unserved(datagram);
  // A socket that is bound to an interface needs no index to find it, also when it is made again.
  if (settings_.names_interface()) to.interface = 0;
  if (is_multicast(to.address)) {
    const NetworkInterface* from = find_interface(datagram.to.interface);
    const auto source = from ? choose_source(from->addresses, datagram.from.address) : std::nullopt;
    if (!source) return;  // no address yet; a searching client asks again
    to.address = *source;
  }
  driver_->on_datagram(datagram.from, to, datagram.bytes, read_clocks());
}

void MqttsnAdapter::drop_unserved(const UdpSocket::Datagram& datagram) {
  ++unserved_;
  const auto count = unserved_lines_.on_event(read_clocks().mono);
  if (!count) return;
  const NetworkInterface* from = find_interface(datagram.to.interface);
  listener_.on_mesh_event(Notice{
      Severity::notice,
      fmt::format("{} datagrams from networks that are not served were dropped, the last one from "
                  "{} over {}; mqttsn.interface says what is served",
                  *count, to_string(Peer{datagram.from, {}}),
                  from ? from->name : fmt::format("interface {}", datagram.to.interface)),
      {}});
}

void MqttsnAdapter::on_decrypted(const UdpSocket::Datagram& datagram, const std::string& identity) {
  driver_->on_datagram(datagram.from, datagram.to, datagram.bytes, read_clocks(), identity);
}

void MqttsnAdapter::perform(SendDatagram& action) {
  if (!action.identity.empty()) {
    if (!dtls_ || !dtls_->send(action.to, action.identity, action.bytes)) ++counts_.sends_failed;
    return;
  }
  const LocalAddress& from = action.from;
  const auto can_reach = [&](const auto& socket) { return socket->can_reach(action.to.address); };
  auto socket = sockets_.end();
  if (from.socket < sockets_.size() && can_reach(sockets_[from.socket])) {
    socket = sockets_.begin() + from.socket;
  } else {  // a restored session may predate a change of `mqttsn.listen`
    socket = std::find_if(sockets_.begin(), sockets_.end(), can_reach);
  }
  if (socket == sockets_.end()) {
    ++counts_.sends_failed;
  } else {
    (*socket)->send_soon(action.to, from, std::move(action.bytes));
  }
}

void MqttsnAdapter::perform(SendMulticast& action) {
  for (const NetworkInterface& interface : interfaces_) {
    const bool is_asked = action.interface == 0 || action.interface == interface.index;
    if (is_asked && takes_multicast(interface)) advertise_on(interface, action.bytes);
  }
}

/// Clients connect to the address that an ADVERTISE comes from, so it must be one that lasts (R16).
void MqttsnAdapter::advertise_on(const NetworkInterface& interface, ByteView bytes) {
  const auto source = lasting_address(interface);
  if (!source) return;
  const auto group = asio::ip::make_address(*settings_.multicast_group);
  for (const auto& socket : sockets_) {
    const Endpoint to = from_asio({group, socket->port()});
    const bool is_sent =
        socket->send(to, {*source, interface.index}, Bytes(bytes.begin(), bytes.end()));
    if (is_sent && interface.has_carrier) advertised_from_[interface.index] = *source;
  }
}

void MqttsnAdapter::perform(MeshEvent& event) { listener_.on_mesh_event(std::move(event)); }

void MqttsnAdapter::watch_interfaces() {
  interfaces_ = read_network_interfaces();
  if (settings_.names_interface()) follow_interface();
  if (std::string thread = thread_interfaces(); thread != only_thread_) {
    only_thread_ = std::move(thread);
    report_open();
  }
  if (settings_.multicast_group) serve_multicast();
  check_interfaces_in(watch_interval);
}

/// Reschedules the next check of the interfaces.
void MqttsnAdapter::check_interfaces_in(Duration delay) {
  watch_timer_.after(delay, [this] { watch_interfaces(); });
}

/// A socket is bound to an interface by its index: an interface made again needs new sockets.
void MqttsnAdapter::follow_interface() {
  const std::uint32_t index = index_of_interface();
  if (index == interface_index_ && (index == 0 || !sockets_.empty())) return;
  interface_index_ = index;
  close();
  if (index == 0)
    return report_link(false, "interface " + settings_.interface + " is gone" + interface_advice);
  try {
    open();
  } catch (const std::runtime_error& error) {
    close();
    report_link(false, error.what());
  }
}

/// Joins the group on each interface that has not joined it yet. Advertises the gateway on
/// interfaces where it was not advertised from its present address (R11).
void MqttsnAdapter::serve_multicast() {
  const auto group = asio::ip::make_address(*settings_.multicast_group);
  std::erase_if(advertised_from_, [&](const auto& past) {
    const NetworkInterface* interface = find_interface(past.first);
    return !interface || !interface->has_carrier;
  });
  for (const NetworkInterface& interface : interfaces_) {
    if (!takes_multicast(interface)) {
      for (const auto& socket : sockets_) socket->leave(group, interface.index);
      continue;
    }
    for (const auto& socket : sockets_) socket->join(group, interface.index);
    const auto source = lasting_address(interface);
    const auto past = advertised_from_.find(interface.index);
    const bool is_news = past == advertised_from_.end() || past->second != source;
    if (is_news && source && interface.has_carrier) driver_->on_interface(interface.index);
  }
}

/// Returns nothing while the interface only has addresses that do not last.
std::optional<IpAddress> MqttsnAdapter::lasting_address(const NetworkInterface& interface) const {
  const auto group = asio::ip::make_address(*settings_.multicast_group);
  return choose_source(interface.addresses, from_asio({group, 0}).address);
}

const NetworkInterface* MqttsnAdapter::find_interface(std::uint32_t index) const {
  const auto found = std::ranges::find(interfaces_, index, &NetworkInterface::index);
  return found == interfaces_.end() ? nullptr : &*found;
}

bool MqttsnAdapter::is_served(std::uint32_t interface) const {
  if (only_thread_.empty()) return true;  // or the socket is bound to the served one
  if (const NetworkInterface* const known = find_interface(interface))
    return known->is_loopback || is_thread_interface(known->name);
  char name[IF_NAMESIZE] = {};  // it was made since the last check
  return if_indextoname(interface, name) && is_thread_interface(name);
}

bool MqttsnAdapter::takes_multicast(const NetworkInterface& interface) const {
  return interface.takes_multicast && is_served(interface.index) &&
         (!settings_.names_interface() || settings_.interface == interface.name);
}

std::string MqttsnAdapter::bound_to() const {
  return settings_.names_interface() ? settings_.interface : "";
}

/// Returns, with `auto`, the present Thread interfaces. If there are any, only these and loopback
/// are served.
std::string MqttsnAdapter::thread_interfaces() const {
  std::string names;
  for (const NetworkInterface& interface : interfaces_) {
    if (settings_.is_auto() && is_thread_interface(interface.name))
      names += (names.empty() ? "" : ", ") + interface.name;
  }
  return names;
}

/// Returns the index of `mqttsn.interface`; 0 when there is no such interface (now).
std::uint32_t MqttsnAdapter::index_of_interface() const {
  const auto found = std::ranges::find(interfaces_, settings_.interface, &NetworkInterface::name);
  return found == interfaces_.end() ? 0 : found->index;
}

void MqttsnAdapter::report_link(bool is_up, std::string detail) {
  listener_.on_mesh_event(LinkChange{Mesh::thread, is_up, std::move(detail)});
}

}  // namespace slamgw::mqttsn

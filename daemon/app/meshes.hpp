// SPDX-License-Identifier: Apache-2.0
// Makes the shells of the enabled meshes from the configuration, and passes each its calls. The
// only place in the daemon that knows the mesh adapters by name.
#pragma once

#include <boost/asio/io_context.hpp>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "daemon/config/config.hpp"
#include "daemon/core/adapter.hpp"
#include "daemon/core/gateway.hpp"
#include "daemon/core/operator_order.hpp"
#include "daemon/core/session_store.hpp"
#include "daemon/runtime/descriptor_store.hpp"
#include "daemon/storage/disk_session_store.hpp"

namespace slamgw {

namespace ble {
class BleMeshShell;
class CobsAdapter;
}  // namespace ble
namespace mqttsn {
class MqttsnAdapter;
}

class Meshes {
 public:
  /// `sessions`, `descriptors` and `listener` must outlive this object.
  Meshes(boost::asio::io_context& io, const Config& config, const TopicScheme& scheme,
         SessionStore& sessions, DescriptorStore& descriptors, MeshListener& listener);
  ~Meshes();

  /// Returns null for a mesh that is not enabled.
  const MeshAdapter* find(Mesh mesh) const { return adapters_[mesh].get(); }
  bool has_any() const;
  /// Returns true if each mesh's shell may be stopped: MeshAdapter::is_settled().
  bool are_settled() const;
  std::optional<Presence> presence_of(Mesh mesh, const std::string& robot) const;

  /// Calls a member of each mesh's shell: `each(&MeshAdapter::trace, true)`.
  template <class Call, class... Arguments>
  void each(Call call, const Arguments&... arguments) {
    for (const auto& adapter : adapters_)
      if (adapter) std::invoke(call, *adapter, arguments...);
  }

  void deliver(const DeliverToMesh& action);
  /// Returns the filters that the gateway's own connection subscribes to for `ble_mesh.relay`;
  /// empty without it.
  std::vector<std::string> relay_filters() const;
  /// Relays a message that one of these filters brought. Returns false for any other message.
  bool takes(const BrokerMessage& message);
  void fire(const Receipt& receipt, ReceiptOutcome outcome);
  /// Applies robots, bans, keys and `topics.extra_*` of a configuration that was read again.
  void reconfigure(const Config& config);
  /// Sets the question whether a robot is known elsewhere. If it is, a CONNECT for a session that
  /// is not here waits for the robot's note.
  void ask_where_served(std::function<bool(const std::string& robot)> served_elsewhere);
  /// For a BLE mesh that several gateways share. `may_serve` is asked before a robot's message is
  /// handled. `on_heard` is called for each message of a robot, with how well the board heard it.
  using OnHeard =
      std::function<void(const std::string& robot, const std::optional<RadioFacts>& radio)>;
  void share_ble(std::function<bool(const std::string& robot)> may_serve, OnHeard on_heard);
  /// True when other gateways have boards in this mesh.
  bool is_shared(Mesh mesh) const;
  /// Calls MeshAdapter::give_up() of each mesh, and returns all messages.
  std::vector<WaitingMessage> give_up(const std::string& robot);
  void manage_ble(BleOrder order, OrderDone done);
  /// Pings the robot over the mesh that reaches it, else over the mesh that knows it.
  void ping(const std::string& robot, OrderDone done);
  /// Returns the sessions of MQTT-SN: mqttsn::client_report().
  OrderAnswer mqttsn_clients(const std::optional<std::string>& robot) const;

 private:
  void make_ble(boost::asio::io_context& io, const Config& config, MeshListener& listener);

  const TopicScheme scheme_;
  const std::vector<std::string> relay_;  // below the prefix
  std::optional<DiskSessionStore> ble_sessions_;
  PerMesh<std::unique_ptr<MeshAdapter>> adapters_;
  ble::BleMeshShell* ble_ = nullptr;         // of `adapters_`, with protocol nordic-serial
  ble::CobsAdapter* cobs_ = nullptr;         // of `adapters_`, with protocol cobs
  mqttsn::MqttsnAdapter* thread_ = nullptr;  // of `adapters_`
};

}  // namespace slamgw

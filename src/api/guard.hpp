// The guard: the one way into a backend's objects.  In this order, for each call: a forked process is refused; the
// object's lock is taken; the backend's entry (backends/entry.hpp) sets the device, forgets earlier requests to stop,
// runs, which orders arrays after the caller's streams (pipeline/arrays.hpp), gives the caller's device back and marks
// what was left half made; what failed is thrown as one Error.
#pragma once
#include <algorithm>
#include <atomic>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include "backends/backend.hpp"
#include "globule/error.hpp"

namespace globule::core {

/// Objects that share memory share one: a simulation, its scene and its tissue.
class GLOBULE_API Gate {
public:
    /// Throws where this thread is inside already, or the process was forked.
    void lock();
    void unlock();

private:
    std::mutex mutex_;
    std::atomic<std::thread::id> owner_{};
};

/// Several gates, always taken in the same order.
class Gates {
public:
    explicit Gates(std::vector<Gate*> gates) : gates_(std::move(gates)) {
        std::sort(gates_.begin(), gates_.end());
        gates_.erase(std::unique(gates_.begin(), gates_.end()), gates_.end());
        try {
            for (; n_locked_ < gates_.size(); ++n_locked_) gates_[n_locked_]->lock();
        } catch (...) {
            unlock();
            throw;
        }
    }
    ~Gates() { unlock(); }
    Gates(const Gates&) = delete;
    Gates& operator=(const Gates&) = delete;

private:
    void unlock() {
        while (n_locked_ > 0) gates_[--n_locked_]->unlock();
    }
    std::vector<Gate*> gates_;
    std::size_t n_locked_ = 0;
};

/// Throws where the process was forked from one that had used globule: threads and devices do not survive a fork.
GLOBULE_API void check_not_forked();
/// Throws what a status says, unless all is well.
GLOBULE_API void check_status(const Status& status);

/// An object of a backend, its entries and its gate.
template <class O> class Handle {
public:
    Handle() = default;
    Handle(const BackendApi& backend, std::shared_ptr<O> object, std::shared_ptr<Gate> gate)
        : backend_(&backend), object_(std::move(object)), gate_(std::move(gate)) {}

    const BackendApi& backend() const { return *backend_; }
    const std::shared_ptr<O>& object() const { return object_; }
    const std::shared_ptr<Gate>& gate() const { return gate_; }
    int device() const { return object_->device(); }
    explicit operator bool() const { return object_ != nullptr; }

    template <auto Method, class... A> auto call(A&&... arguments) const {
        return call_inside<Method>(
            Gates(gate_ ? std::vector<Gate*>{gate_.get()} : std::vector<Gate*>{}), std::forward<A>(arguments)...);
    }
    /// Where other objects' gates were taken with this one's.
    template <auto Method, class... A> auto call_inside(const Gates&, A&&... arguments) const {
        const auto method = [&]() -> decltype(auto) { return (object_.get()->*Method)(std::forward<A>(arguments)...); };
        if constexpr (std::is_void_v<decltype(method())>) return run(method);
        else {
            std::optional<decltype(method())> result;
            run([&] { result.emplace(method()); });
            return *std::move(result);
        }
    }
    /// Finished frames do not change: they need no gate.
    template <auto Method, class... A> auto read(A&&... arguments) const {
        check_not_forked();
        return call_inside<Method>(Gates({}), std::forward<A>(arguments)...);
    }

private:
    template <class Body> void run(const Body& body) const {
        check_status(backend_->run(
            *object_, [](void* context) { (*static_cast<const Body*>(context))(); }, const_cast<Body*>(&body)));
    }

    const BackendApi* backend_ = nullptr;
    std::shared_ptr<O> object_;
    std::shared_ptr<Gate> gate_;
};

GLOBULE_API Handle<Scene> make_scene(const BackendApi& backend, int device, int threads, Poll* poll);
GLOBULE_API Handle<Reconstructor> make_reconstructor(const BackendApi& backend, int device, int threads, Poll* poll);
GLOBULE_API Handle<Tissue> make_tissue(const BackendApi& backend, int device, int threads, Poll* poll);
/// Shares the scene's gate.
GLOBULE_API Handle<Simulation> make_simulation(const Handle<Scene>& scene);
/// One line naming a device, or why it cannot be used (then ok is false).
GLOBULE_API std::string describe(const BackendApi& backend, int device, bool& ok);

/// All layers' scenes are locked; none changes before the picture was asked for.
GLOBULE_API Handle<Frame> render(
    const std::vector<Handle<Scene>>& layers, const PictureRequest& request, const Handle<Frame>& before);

/// Arrays of one call, where an object on `device` can use them: what lies on a GPU is copied to the host for a CPU's
/// object.
class GLOBULE_API Arrays {
public:
    explicit Arrays(int device) : device_(device) {}
    template <class T> ArrayAt<const T> reach(const char* name, const ArrayAt<const T>& array, std::size_t n) {
        const AnyArray found = reach_bytes(name, {array.data, array.device, array.stream}, n * sizeof(T));
        return {static_cast<const T*>(found.data), found.device, found.stream};
    }
    AnyArray reach_bytes(const char* name, const AnyArray& array, std::size_t bytes);

private:
    int device_;
    std::vector<std::unique_ptr<char[]>> copies_;
};

}  // namespace globule::core

#include "api/guard.hpp"

#include <pthread.h>

#include "backends/open.hpp"

namespace globule {

Error::~Error() = default;

const char* version() noexcept {
#define GLOBULE_TEXT(x) #x
#define GLOBULE_DOTTED(a, b, c) GLOBULE_TEXT(a) "." GLOBULE_TEXT(b) "." GLOBULE_TEXT(c)
    return GLOBULE_DOTTED(GLOBULE_VERSION_MAJOR, GLOBULE_VERSION_MINOR, GLOBULE_VERSION_PATCH);
}

namespace core {
namespace {

std::atomic<bool> forked{false};

/// From the first use on, a child of this process knows that it is one.
void watch_forks() {
    static const int watching = pthread_atfork(nullptr, nullptr, [] { forked = true; });
    (void)watching;
}

template <class O, class Make> Handle<O> made(const BackendApi& backend, const Make& make) {
    check_not_forked();
    std::shared_ptr<O> object;
    check_status(make(&object));
    return {backend, std::move(object), std::make_shared<Gate>()};
}

}  // namespace

void check_not_forked() {
    watch_forks();
    if (forked)
        throw Error(ErrorCode::forked,
            "this process was forked from one that had used globule, whose threads and devices it does not have: start "
            "it anew "
            "(in Python: multiprocessing.get_context(\"spawn\"))");
}

void check_status(const Status& status) {
    switch (status.code) {
        case Code::ok:
            return;
        case Code::cancelled:
            throw Error(ErrorCode::cancelled, status.message);
        case Code::refused:
            throw Error(ErrorCode::invalid, status.message);
        case Code::stale:
            throw Error(ErrorCode::stale, status.message);
        case Code::memory:
            throw Error(ErrorCode::memory, status.message);
        case Code::device:
            throw Error(ErrorCode::device, status.message);
        case Code::failed:
            throw Error(ErrorCode::internal, status.message);
    }
}

void Gate::lock() {
    check_not_forked();
    const std::thread::id self = std::this_thread::get_id();
    if (owner_.load(std::memory_order_relaxed) == self)
        throw Error(ErrorCode::busy,
            "this thread is inside another call on the same object (a signal handler, say): call again when that "
            "returned");
    mutex_.lock();
    owner_.store(self, std::memory_order_relaxed);
}

void Gate::unlock() {
    owner_.store({}, std::memory_order_relaxed);
    mutex_.unlock();
}

Handle<Scene> make_scene(const BackendApi& backend, int device, int threads, Poll* poll) {
    return made<Scene>(backend, [&](auto* out) { return backend.make_scene(device, threads, poll, out); });
}
Handle<Reconstructor> make_reconstructor(const BackendApi& backend, int device, int threads, Poll* poll) {
    return made<Reconstructor>(
        backend, [&](auto* out) { return backend.make_reconstructor(device, threads, poll, out); });
}
Handle<Tissue> make_tissue(const BackendApi& backend, int device, int threads, Poll* poll) {
    return made<Tissue>(backend, [&](auto* out) { return backend.make_tissue(device, threads, poll, out); });
}
Handle<Simulation> make_simulation(const Handle<Scene>& scene) {
    const Gates inside({scene.gate().get()});
    std::shared_ptr<Simulation> object;
    check_status(scene.backend().make_simulation(scene.object(), &object));
    return {scene.backend(), std::move(object), scene.gate()};
}
std::string describe(const BackendApi& backend, int device, bool& ok) {
    check_not_forked();
    std::string text;
    check_status(backend.describe(device, &ok, &text));
    return text;
}

Handle<Frame> render(
    const std::vector<Handle<Scene>>& layers, const PictureRequest& request, const Handle<Frame>& before) {
    std::vector<Gate*> gates;
    for (const Handle<Scene>& layer : layers) gates.push_back(layer.gate().get());
    const Gates inside(std::move(gates));
    return {layers[0].backend(), layers[0].call_inside<&Scene::render>(inside, request, before.object()), nullptr};
}

AnyArray Arrays::reach_bytes(const char* name, const AnyArray& array, std::size_t bytes) {
    if (!array.data || array.device == kHost) return array;
    const BackendApi* cuda = nullptr;
    try {
        cuda = &open_backend("cuda");
    } catch (const Error& e) {
        throw Error(ErrorCode::invalid,
            std::string(name) + ": expected memory that can be reached, got an array on a GPU (" + e.what() + ")");
    }
    AnyArray found = array;
    if (found.device == kSomeDevice) {
        const Status status = cuda->locate(array.data, &found.device);
        if (status.code != Code::ok)
            throw Error(ErrorCode::invalid,
                std::string(name) +
                    ": expected memory that can be reached, got an address on a GPU that does not answer (" +
                    status.message + ")");
    }
    if (found.device == kHost || device_ != kHost) return found;
    copies_.push_back(std::make_unique<char[]>(bytes ? bytes : 1));
    check_status(cuda->fetch(copies_.back().get(), found, bytes));
    return {copies_.back().get(), kHost, 0};
}

}  // namespace core
}  // namespace globule

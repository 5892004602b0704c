#include "globule/frame.hpp"

#include "api/impl.hpp"

namespace globule {
namespace {

std::size_t channels_of(core::Image image) {
    return image == core::Image::depth || image == core::Image::layer ? 1 : 3;
}
bool is_bytes(core::Image image) { return image == core::Image::picture || image == core::Image::layer; }

template <class T> std::vector<T> read(const Inside::FrameImpl& f, core::Image image) {
    std::vector<T> out(std::size_t(f.width) * f.height * channels_of(image));
    f.core.read<&core::Frame::read>(image, core::ArrayAt<void>{out.data(), core::kHost, 0});
    return out;
}

void check_out(
    const Inside::FrameImpl& f, const char* name, const MutableArrayView& out, std::size_t channels, DType type) {
    const Shape whole = channels == 1 ? Shape(f.height, f.width) : Shape(f.height, f.width, channels);
    if (out.dtype() != type) refuse(name, std::string("an array of ") + name_of(type), name_of(out.dtype()));
    if (!(out.shape() == whole) && !(out.shape() == Shape(whole.size())))
        refuse(name, "shape " + text(whole), text(out.shape()));
    if (!out.data()) refuse(name, "an address", "null");
}

void copy(const Inside::FrameImpl& f, const char* name, core::Image image, const MutableArrayView& out) {
    check_out(f, name, out, channels_of(image), is_bytes(image) ? DType::uint8 : DType::float32);
    core::ArrayAt<void> to{out.data(), out.where().device, out.where().stream};
    if (to.device != core::kHost) {
        if (f.device_number == core::kHost)
            refuse(name, "host memory, where this frame is", "memory of " + name_of_device(to.device));
        if (to.device == core::kSomeDevice) core::check_status(f.core.backend().locate(out.data(), &to.device));
        if (to.device != core::kHost && to.device != f.device_number)
            refuse(name, "host memory or memory of " + f.device, "memory of " + name_of_device(to.device));
    }
    f.core.read<&core::Frame::read>(image, to);
}

}  // namespace

int Frame::width() const { return Inside::of(*this, "frame").width; }
int Frame::height() const { return Inside::of(*this, "frame").height; }
int Frame::samples() const { return Inside::of(*this, "frame").core.read<&core::Frame::passes>(); }
double Frame::trace_seconds() const { return Inside::of(*this, "frame").core.read<&core::Frame::trace_seconds>(); }
const std::string& Frame::device() const { return Inside::of(*this, "frame").device; }

std::vector<float> Frame::color() const { return read<float>(Inside::of(*this, "frame"), core::Image::color); }
std::vector<std::uint8_t> Frame::image() const {
    return read<std::uint8_t>(Inside::of(*this, "frame"), core::Image::picture);
}
std::vector<float> Frame::distance() const { return read<float>(Inside::of(*this, "frame"), core::Image::depth); }
std::vector<float> Frame::normal() const { return read<float>(Inside::of(*this, "frame"), core::Image::normal); }
std::vector<float> Frame::position() const { return read<float>(Inside::of(*this, "frame"), core::Image::position); }
std::vector<float> Frame::albedo() const { return read<float>(Inside::of(*this, "frame"), core::Image::albedo); }
std::vector<std::uint8_t> Frame::layer() const {
    return read<std::uint8_t>(Inside::of(*this, "frame"), core::Image::layer);
}
std::vector<std::uint8_t> Frame::mask() const {
    const std::vector<float> t = distance();
    std::vector<std::uint8_t> out(t.size());
    for (std::size_t i = 0; i < t.size(); ++i) out[i] = std::isfinite(t[i]);
    return out;
}

void Frame::color(const MutableArrayView& out) const {
    copy(Inside::of(*this, "frame"), "color", core::Image::color, out);
}
void Frame::image(const MutableArrayView& out) const {
    copy(Inside::of(*this, "frame"), "image", core::Image::picture, out);
}
void Frame::distance(const MutableArrayView& out) const {
    copy(Inside::of(*this, "frame"), "distance", core::Image::depth, out);
}
void Frame::normal(const MutableArrayView& out) const {
    copy(Inside::of(*this, "frame"), "normal", core::Image::normal, out);
}
void Frame::position(const MutableArrayView& out) const {
    copy(Inside::of(*this, "frame"), "position", core::Image::position, out);
}
void Frame::albedo(const MutableArrayView& out) const {
    copy(Inside::of(*this, "frame"), "albedo", core::Image::albedo, out);
}
void Frame::layer(const MutableArrayView& out) const {
    copy(Inside::of(*this, "frame"), "layer", core::Image::layer, out);
}
void Frame::mask(const MutableArrayView& out) const {
    check_out(Inside::of(*this, "frame"), "mask", out, 1, DType::uint8);
    if (out.where().device != Location::host)
        refuse("mask", "host memory (on a GPU, take distance, which is infinite where missed)", "memory of a GPU");
    const std::vector<std::uint8_t> found = mask();
    std::copy(found.begin(), found.end(), static_cast<std::uint8_t*>(out.data()));
}

}  // namespace globule

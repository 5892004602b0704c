// Tissue's arrays: bodies that come, what a checkpoint keeps, what follows from it.
#pragma once
#include "sim/tissue.hpp"

namespace globule::core {

template <class Exec> void TissueImpl<Exec>::add(const TissueArrays& in) {
    if (in.n == 0) return;
    if (n_ > 0 && is_solid_ != (in.lame != nullptr))
        throw Refused("tissue: expected bodies of one model, got solids beside bonds");
    disturbed();
    loaded_ = false;
    is_solid_ = in.lame != nullptr;
    contact_ = in.contact;
    const std::uint32_t before = ceil_div<std::uint32_t>(n_, tissue::kBlock) * tissue::kBlock, old = n_;
    const BondBlocks blocks(in, before, n_entries_);
    std::vector<std::uint32_t> bodies(bodies_known_ ? old : 0);  // cuts since have made no others of them
    if (!bodies.empty()) exec_.download(bodies.data(), body_.data(), bodies.size() * sizeof bodies[0]);
    std::vector<Quad> at(in.n), velocity(in.n);
    for (std::uint32_t t = 0; t < in.n; ++t) {
        const float* p = in.positions + 3 * std::size_t(t);
        at[t] = {p[0], p[1], p[2], in.inverse_mass[t] * in.bound[t]};
        velocity[t] = {0, 0, 0, in.inverse_mass[t]};
    }
    extend(at_, old, before, at.data(), in.n, Quad{0, 0, 0, 0});
    extend(velocity_, old, before, velocity.data(), in.n, Quad{0, 0, 0, 0});
    if (is_solid_) add_solid(in, old, before, at);
    extend(id_, old, before, in.ids, in.n, tissue::kNobody);
    extend(hold_, old, before, in.hold, in.n, tissue::kGone);
    extend(phase_, old, before, in.phase, in.n, std::uint8_t(0));
    const std::vector<float> none(in.n, 0.0f);
    const std::vector<float3> still(in.n, float3{0, 0, 0});
    extend(by_pressure_, old, before, still.data(), in.n, float3{0, 0, 0});
    extend(owed_, old, before, still.data(), in.n, float3{0, 0, 0});
    extend(volume_, old, before, none.data(), in.n, 0.0f);
    extend(wetness_, old, before, none.data(), in.n, 0.0f);
    const std::vector<std::uint8_t> whole(in.n, 0);
    extend(whose_, old, before, whole.data(), in.n, std::uint8_t(0));
    extend(scarred_, old, before, whole.data(), in.n, std::uint8_t(0));
    const std::uint32_t n_blocks = before / tissue::kBlock;
    extend(first_, n_blocks, n_blocks, blocks.first.data(), blocks.first.size(), 0u);
    extend(other_, n_entries_, n_entries_, blocks.other.data(), blocks.other.size(), 0u);
    extend(length_, n_entries_, n_entries_, blocks.length.data(), blocks.length.size(), 0.0f);
    extend(stiffness_, n_entries_, n_entries_, blocks.stiffness.data(), blocks.stiffness.size(), 0.0f);
    extend(vessel_, n_entries_, n_entries_, blocks.vessel.data(), blocks.vessel.size(), std::uint8_t(0));
    n_ = before + in.n;
    n_entries_ += std::uint32_t(blocks.other.size());
    make_room();
    find_labels(body_.reserve(n_));
    if (!bodies.empty()) exec_.upload(body_.data(), bodies.data(), bodies.size() * sizeof bodies[0]);
    exec_.synchronize();
    bodies_known_ = true;
    follow();
}

template <class Exec>
void TissueImpl<Exec>::add_solid(
    const TissueArrays& in, std::uint32_t old, std::uint32_t before, const std::vector<Quad>& at) {
    extend(rest_at_, old, before, at.data(), in.n, Quad{0, 0, 0, 0});
    const std::vector<float> none(in.n, tissue::kNotSlid);
    extend(spared_, old, before, none.data(), in.n, tissue::kNotSlid);
    const std::uint32_t all = before + ceil_div<std::uint32_t>(in.n, tissue::kBlock) * tissue::kBlock, was = stride();
    std::vector<float> lame = widened(lame_, 2, was, 2, all);
    for (int k = 0; k < 2; ++k)
        std::copy_n(in.lame + k * std::size_t(in.n), in.n, lame.data() + k * std::size_t(all) + before);
    put(lame_, lame.data(), lame.size());
    const std::uint32_t n_terms = std::max(n_terms_, in.n_terms);
    std::vector<float> terms = widened(terms_, tissue::kTermRows * n_terms_, was, tissue::kTermRows * n_terms, all);
    for (std::uint32_t k = 0; k < in.n_terms; ++k)
        for (int a = 0; a < 2; ++a)
            std::fill_n(
                terms.data() + (tissue::kTermRows * k + a) * std::size_t(all) + before, in.n, in.relaxation[2 * k + a]);
    put(terms_, terms.data(), terms.size());
    n_terms_ = n_terms;
    const std::vector<float> stays = yielded_ ? widened(stays_, 6, was, 6, all) : std::vector<float>();
    put(stays_, stays.data(), stays.size());
    float most = in.frequency, other = 0.0f;
    if (was) exec_.download(&other, frequency_.data(), sizeof other);
    most = std::max(most, other);
    put(frequency_, &most, 1);
    exec_.synchronize();
}

template <class Exec> void TissueImpl<Exec>::put_none_slid() {
    const std::vector<float> none(is_solid_ ? n_ : 0, tissue::kNotSlid);
    put(spared_, none.data(), none.size());
    exec_.synchronize();
}

template <class Exec>
std::vector<float> TissueImpl<Exec>::widened(const Buffer<float, Exec>& buffer, std::uint32_t rows_were,
    std::uint32_t was, std::uint32_t rows, std::uint32_t all) {
    std::vector<float> out(rows * std::size_t(all), 0.0f), earlier(rows_were * std::size_t(was));
    if (!earlier.empty()) exec_.download(earlier.data(), buffer.data(), earlier.size() * sizeof(float));
    for (std::uint32_t k = 0; k < rows_were; ++k)
        std::copy_n(earlier.data() + k * std::size_t(was), was, out.data() + k * std::size_t(all));
    return out;
}

template <class Exec> void TissueImpl<Exec>::write(const std::string& name, const void* in, std::size_t bytes) {
    disturbed();
    if (name == "hold") n_ = std::uint32_t(bytes);
    if (name == "hold" || name == "id") is_written_ = name == "hold";
    if (name == "other") n_entries_ = std::uint32_t(bytes / 4);
    if (name == "hold") is_solid_ = yielded_ = loaded_ = false, n_terms_ = 0;
    if (name == "rest") is_solid_ = bytes > 0;
    if (name == "terms" && n_)
        n_terms_ = std::uint32_t(
            std::min<std::size_t>(bytes / (sizeof(float) * tissue::kTermRows * stride()), tissue::kMostTerms));
    if (name == "stays") yielded_ = bytes > 0;
    if (name == "loads") loaded_ = bytes > 0;
    if (name == "hold" || name == "body") bodies_known_ = name == "body" && bytes > 0;
    if (name == "hold") {
        for (auto* b : {&by_pressure_, &owed_})  // earlier versions did not save it
            exec_.clear(b->reserve(n_), n_ * sizeof(float3));
        grasped_ = 0;
        for (std::size_t t = 0; t < bytes; ++t)
            if (const int g = static_cast<const std::uint8_t*>(in)[t] - tissue::kGrasped;
                g >= 0 && g < tissue::kMaxGrasps)
                grasped_ |= 1u << g;
    }
    each_array([&](const char* its, auto& buffer, std::size_t n) {
        if (name != its) return;
        const std::size_t wanted = n * sizeof *buffer.data();
        if (bytes != wanted)
            throw Refused(
                "tissue_" + name + ": expected " + std::to_string(wanted) + " bytes, got " + std::to_string(bytes));
        exec_.upload(buffer.reserve(n), in, wanted);
    });
    exec_.synchronize();
    if (name == "rest") put_none_slid();  // earlier versions did not save it
    if (name == "id") {
        make_room();
        if (!bodies_known_)
            exec_.clear(body_.reserve(n_), n_ * sizeof *body_.data());  // earlier versions saved those of solids alone
        n_scars_ = 1;                                                   // as if there were some
    }
}

template <class Exec> template <class Fn> void TissueImpl<Exec>::each_array(const Fn& fn) {
    fn("hold", hold_, n_);
    fn("other", other_, n_entries_);
    fn("rest", rest_at_, is_solid_ ? n_ : 0);
    fn("lame", lame_, is_solid_ ? 2 * stride() : 0);
    fn("terms", terms_, n_terms_ * std::size_t(tissue::kTermRows) * stride());
    fn("stays", stays_, yielded_ ? 6 * std::size_t(stride()) : 0);
    fn("loads", contact_loads_, loaded_ ? 2 * std::size_t(n_) : 0);
    fn("frequency", frequency_, is_solid_ ? 1 : 0);
    fn("body", body_, n_);
    fn("spared", spared_, is_solid_ ? n_ : 0);
    fn("at", at_, n_);
    fn("velocity", velocity_, n_);
    fn("phase", phase_, n_);
    fn("scarred", scarred_, n_);
    fn("volume", volume_, n_);
    fn("whose", whose_, n_);
    fn("wetness", wetness_, n_);
    fn("first", first_, n_ ? ceil_div<std::size_t>(n_, tissue::kBlock) + 1 : 0);
    fn("length", length_, n_entries_);
    fn("stiffness", stiffness_, n_entries_);
    fn("vessel", vessel_, n_entries_);
    fn("before", before_, n_);
    fn("pressed", by_pressure_, n_);
    fn("owed", owed_, is_solid_ ? n_ : 0);
    fn("id", id_, n_);
}

template <class Exec> void TissueImpl<Exec>::make_room() {
    for (auto* b : {&acceleration_, &rest_, &drag_}) b->reserve(n_);
    next_.reserve(n_);
    slot_.reserve(n_);
    before_.reserve(n_);
    std::vector<std::uint32_t> ids(n_);
    exec_.download(ids.data(), id_.data(), n_ * sizeof ids[0]);
    n_ids_ = 0;
    for (std::uint32_t id : ids)
        if (id != tissue::kNobody) n_ids_ = std::max(n_ids_, id + 1);
    std::vector<std::uint32_t> of_id(n_ids_, tissue::kNobody);
    for (std::uint32_t t = 0; t < n_; ++t)
        if (ids[t] != tissue::kNobody) of_id[ids[t]] = t;
    put(of_id_, of_id.data(), of_id.size());
    exec_.synchronize();
    pieces_known_ = pulled_ = corrected_ = feels_ = false;
    if (!is_solid_) {
        fastest_ = fastest_bond();
        return;
    }
    rows_.reserve(3 * std::size_t(stride()));
    exec_.for_each(n_, tissue::FindQuiet{bonds(), hold_.data(), quiet_.reserve(n_)});
    exec_.clear(correction_.reserve(6 * std::size_t(stride())), 6 * std::size_t(stride()) * sizeof(float));
    float frequency;
    exec_.download(&frequency, frequency_.data(), sizeof frequency);
    fastest_ = frequency;  // stable up to twice that step: what is strained is stiffer
}

template <class Exec> double TissueImpl<Exec>::fastest_bond() {
    std::vector<Quad> at(n_);
    std::vector<std::uint32_t> first(ceil_div<std::size_t>(n_, tissue::kBlock) + 1), other(n_entries_);
    std::vector<float> stiffness(n_entries_);
    exec_.download(at.data(), at_.data(), n_ * sizeof at[0]);
    exec_.download(first.data(), first_.data(), first.size() * sizeof first[0]);
    exec_.download(other.data(), other_.data(), n_entries_ * sizeof other[0]);
    exec_.download(stiffness.data(), stiffness_.data(), n_entries_ * sizeof stiffness[0]);
    double fastest2 = 0.0;
    for (std::uint32_t t = 0; t < n_; ++t)
        for (std::uint32_t e = first[t / tissue::kBlock] + t % tissue::kBlock; e < first[t / tissue::kBlock + 1];
            e += tissue::kBlock)
            fastest2 = std::max(fastest2, double(stiffness[e]) * (double(at[t].w) + at[other[e]].w));
    return std::sqrt(fastest2);
}

template <class Exec>
template <class T>
void TissueImpl<Exec>::extend(
    Buffer<T, Exec>& buffer, std::size_t n_old, std::size_t begin, const T* more, std::size_t m, const T& between) {
    std::vector<T> all(begin + m, between);
    if (n_old) exec_.download(all.data(), buffer.data(), n_old * sizeof(T));
    if (m) std::memcpy(all.data() + begin, more, m * sizeof(T));
    put(buffer, all.data(), all.size());
    exec_.synchronize();
}

template <class Exec> void TissueImpl<Exec>::take_out(const Buffer<Quad, Exec>& buffer, float* to) {
    if (!to) return;
    std::vector<Quad> all(n_);
    exec_.download(all.data(), buffer.data(), n_ * sizeof(Quad));
    for (std::size_t t = 0; t < n_; ++t) std::memcpy(to + 3 * t, &all[t], 3 * sizeof(float));
}

template <class Exec> void TissueImpl<Exec>::put_in(Buffer<Quad, Exec>& buffer, const float* from) {
    if (!from) return;
    std::vector<Quad> all(n_);
    exec_.download(all.data(), buffer.data(), n_ * sizeof(Quad));
    for (std::size_t t = 0; t < n_; ++t) std::memcpy(&all[t], from + 3 * t, 3 * sizeof(float));
    put(buffer, all.data(), n_);
    exec_.synchronize();
}

}  // namespace globule::core

// The parts of a training step that PyTorch is slow at on a CPU: many tiny products and selections.
//
// Plain C interface, called through ctypes, so that one file builds in a second and serves every PyTorch version.
// Everything is computed in one pass that stays in the first cache; on a GPU the PyTorch forms are used instead.
//
// Work is split over items of the batch, and what items share (gradients of weights) is summed in item order, so
// results do not depend on the number of threads.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

namespace {

constexpr int G = 12;      // growth of an edge block: channels of each of its three maps
constexpr int LANES = 16;  // G padded to a vector

typedef float Vec __attribute__((vector_size(64)));
typedef int32_t Ints __attribute__((vector_size(64)));

Vec load(const float* source) {
    Vec v;
    std::memcpy(&v, source, sizeof v);
    return v;
}

Vec load_padded(const float* source) {
    float padded[LANES] = {};
    std::memcpy(padded, source, G * sizeof(float));
    return load(padded);
}

void add_unpadded(float* target, Vec v) {
    for (int g = 0; g < G; ++g) target[g] += v[g];
}

Vec positive(Vec v) {
    const Vec zero = {};
    return v > zero ? v : zero;
}

Vec where_positive(Vec condition, Vec v) {
    const Vec zero = {};
    return condition > zero ? v : zero;
}

// A G x G matrix, rows padded; `apply` is the product of a row vector with it, added to `sum`.
struct Matrix {
    Vec rows[G];
    Matrix(const float* weights, bool transposed) {
        float padded[LANES] = {};
        for (int r = 0; r < G; ++r) {
            for (int c = 0; c < G; ++c) padded[c] = transposed ? weights[c * G + r] : weights[r * G + c];
            rows[r] = load(padded);
        }
    }
    Vec apply(Vec v, Vec sum) const {
        for (int g = 0; g < G; ++g) sum += v[g] * rows[g];
        return sum;
    }
};

struct Weights {
    Matrix a_to_b, a_to_c, b_to_c;
    Weights(const float* ab, const float* ac, const float* bc, bool transposed)
        : a_to_b(ab, transposed), a_to_c(ac, transposed), b_to_c(bc, transposed) {}
};

// Floats in an order-keeping integer form.
int32_t ordered(float value) {
    int32_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return bits ^ ((bits >> 31) & 0x7fffffff);
}

// The k smallest of `count` keys, by bisection on the threshold: counting is one vector pass, and needs no moves.
void smallest(const int32_t* keys, int count, int k, int32_t* out) {
    int32_t low = std::numeric_limits<int32_t>::max(), high = std::numeric_limits<int32_t>::min();
    for (int j = 0; j < count; ++j) {
        low = std::min(low, keys[j]);
        high = std::max(high, keys[j]);
    }
    int within = count;
    while (low < high) {
        const int32_t middle = (int32_t)(((int64_t)low + high) >> 1);
        int below = 0;
        for (int j = 0; j < count; ++j) below += keys[j] <= middle;
        if (below >= k) {
            high = middle;
            within = below;
            if (below == k) break;
        } else {
            low = middle + 1;
        }
    }
    int found = 0;
    if (within == k) {
        int32_t scratch[2048];
        int32_t* target = count <= 2047 ? scratch : nullptr;
        if (target) {
            for (int j = 0; j < count; ++j) {
                target[found] = j;
                found += keys[j] <= high;
            }
            std::memcpy(out, target, k * sizeof(int32_t));
            return;
        }
    }
    // Ties at the threshold: the lowest indices win.
    for (int j = 0; j < count; ++j)
        if (keys[j] < high) out[found++] = j;
    for (int j = 0; j < count && found < k; ++j)
        if (keys[j] == high) out[found++] = j;
}

void neighbours_of_item(const float* features, int count, int channels, int k, int32_t* out) {
    const int padded = (count + 127) / 128 * 128;
    std::vector<float> columns((size_t)channels * padded, 0.0f), squares(padded, std::numeric_limits<float>::infinity());
    std::vector<int32_t> keys(padded);
    for (int j = 0; j < count; ++j) {
        float square = 0;
        for (int c = 0; c < channels; ++c) {
            const float value = features[(size_t)j * channels + c];
            columns[(size_t)c * padded + j] = value;
            square += value * value;
        }
        squares[j] = square;
    }
    for (int i = 0; i < count; ++i) {
        const float* own = features + (size_t)i * channels;
        for (int start = 0; start < padded; start += 128) {
            float sums[128];
            std::memcpy(sums, squares.data() + start, sizeof sums);
            for (int c = 0; c < channels; ++c) {
                const float factor = -2.0f * own[c];
                const float* column = columns.data() + (size_t)c * padded + start;
                for (int j = 0; j < 128; ++j) sums[j] += factor * column[j];
            }
            for (int j = 0; j < 128; ++j) keys[start + j] = ordered(sums[j]);
        }
        keys[i] = std::numeric_limits<int32_t>::max();  // not its own neighbour
        smallest(keys.data(), count, k, out + (size_t)i * k);
    }
}

void forward_of_item(const float* own_a, const float* own_b, const float* other, const Weights& weights,
                     const int32_t* indices, int count, int k, float* out, uint8_t* argmax) {
    std::vector<float> padded((size_t)count * LANES, 0.0f);
    for (int j = 0; j < count; ++j) std::memcpy(&padded[(size_t)j * LANES], other + (size_t)j * G, G * sizeof(float));
    const float lowest = -std::numeric_limits<float>::infinity();
    for (int i = 0; i < count; ++i) {
        const Vec base_a = load_padded(own_a + (size_t)i * G), base_b = load_padded(own_b + (size_t)i * G);
        const Vec none = Vec{} + lowest;
        Vec best[3] = {none, none, none};
        Ints at[3] = {};
        for (int n = 0; n < k; ++n) {
            const Vec a = positive(base_a + load(&padded[(size_t)indices[(size_t)i * k + n] * LANES]));
            const Vec b = positive(weights.a_to_b.apply(a, base_b));
            const Vec c = weights.b_to_c.apply(b, weights.a_to_c.apply(a, Vec{}));
            const Ints here = Ints{} + n;
            const Vec values[3] = {c, b, a};
            for (int m = 0; m < 3; ++m) {
                const Ints better = values[m] > best[m];
                best[m] = better ? values[m] : best[m];
                at[m] = better ? here : at[m];
            }
        }
        for (int m = 0; m < 3; ++m)
            for (int g = 0; g < G; ++g) {
                out[((size_t)i * 3 + m) * G + g] = best[m][g];
                argmax[((size_t)i * 3 + m) * G + g] = (uint8_t)at[m][g];
            }
    }
}

struct Gradients {
    float *own_a, *own_b, *other;           // [count, G] of one item
    float *a_to_b, *a_to_c, *b_to_c;        // [G, G] of one item
};

void backward_of_item(const float* own_a, const float* own_b, const float* other, const Weights& weights,
                      const Weights& transposed, const int32_t* indices, const uint8_t* argmax, const float* grad_out,
                      int count, int k, Gradients gradients) {
    std::vector<float> padded((size_t)count * LANES, 0.0f), grad_other((size_t)count * LANES, 0.0f);
    for (int j = 0; j < count; ++j) std::memcpy(&padded[(size_t)j * LANES], other + (size_t)j * G, G * sizeof(float));
    // Of an edge, only the channels in which it was the largest have a gradient: [edge][c, b, a].
    std::vector<float> sparse((size_t)k * 3 * LANES, 0.0f);
    std::vector<uint8_t> touched(k, 0);
    Vec grad_ab[G] = {}, grad_ac[G] = {}, grad_bc[G] = {};
    for (int i = 0; i < count; ++i) {
        for (int m = 0; m < 3; ++m)
            for (int g = 0; g < G; ++g) {
                const size_t place = ((size_t)i * 3 + m) * G + g;
                const int edge = argmax[place];
                sparse[((size_t)edge * 3 + m) * LANES + g] = grad_out[place];
                touched[edge] |= (uint8_t)(1 << m);
            }
        const Vec base_a = load_padded(own_a + (size_t)i * G), base_b = load_padded(own_b + (size_t)i * G);
        Vec sum_a = {}, sum_b = {};
        for (int n = 0; n < k; ++n) {
            if (!touched[n]) continue;
            float* edge = &sparse[(size_t)n * 3 * LANES];
            const size_t neighbour = (size_t)indices[(size_t)i * k + n] * LANES;
            const Vec a = positive(base_a + load(&padded[neighbour]));
            Vec grad_a = load(edge + 2 * LANES);
            if (touched[n] & 3) {
                const Vec b = positive(weights.a_to_b.apply(a, base_b));
                Vec grad_b = load(edge + LANES);
                if (touched[n] & 1) {
                    const Vec grad_c = load(edge);
                    grad_b = transposed.b_to_c.apply(grad_c, grad_b);
                    grad_a = transposed.a_to_c.apply(grad_c, grad_a);
                    for (int g = 0; g < G; ++g) {
                        grad_ac[g] += a[g] * grad_c;
                        grad_bc[g] += b[g] * grad_c;
                    }
                }
                grad_b = where_positive(b, grad_b);
                for (int g = 0; g < G; ++g) grad_ab[g] += a[g] * grad_b;
                grad_a = transposed.a_to_b.apply(grad_b, grad_a);
                sum_b += grad_b;
            }
            grad_a = where_positive(a, grad_a);
            sum_a += grad_a;
            const Vec total = load(&grad_other[neighbour]) + grad_a;
            std::memcpy(&grad_other[neighbour], &total, sizeof total);
            std::memset(edge, 0, 3 * LANES * sizeof(float));
            touched[n] = 0;
        }
        add_unpadded(gradients.own_a + (size_t)i * G, sum_a);
        add_unpadded(gradients.own_b + (size_t)i * G, sum_b);
    }
    for (int j = 0; j < count; ++j) add_unpadded(gradients.other + (size_t)j * G, load(&grad_other[(size_t)j * LANES]));
    for (int g = 0; g < G; ++g) {
        add_unpadded(gradients.a_to_b + g * G, grad_ab[g]);
        add_unpadded(gradients.a_to_c + g * G, grad_ac[g]);
        add_unpadded(gradients.b_to_c + g * G, grad_bc[g]);
    }
}

// For each of `count` points its nearest among `others`; ties go to the lowest index.
void nearest_of_item(const float* points, int count, const float* others, int other_count, int64_t* out) {
    const int padded = (other_count + LANES - 1) / LANES * LANES;
    std::vector<float> axes((size_t)3 * padded, std::numeric_limits<float>::infinity());
    for (int j = 0; j < other_count; ++j)
        for (int axis = 0; axis < 3; ++axis) axes[(size_t)axis * padded + j] = others[(size_t)j * 3 + axis];
    Ints lanes;
    for (int l = 0; l < LANES; ++l) lanes[l] = l;
    for (int i = 0; i < count; ++i) {
        Vec best = Vec{} + std::numeric_limits<float>::infinity();
        Ints at = {};
        for (int j = 0; j < padded; j += LANES) {
            const Vec x = load(&axes[j]) - points[i * 3], y = load(&axes[padded + j]) - points[i * 3 + 1];
            const Vec z = load(&axes[2 * padded + j]) - points[i * 3 + 2];
            const Vec distance = x * x + y * y + z * z;
            const Ints better = distance < best;
            best = better ? distance : best;
            at = better ? lanes + j : at;
        }
        int winner = 0;
        for (int l = 1; l < LANES; ++l)
            if (best[l] < best[winner] || (best[l] == best[winner] && at[l] < at[winner])) winner = l;
        out[i] = std::min(at[winner], other_count - 1);
    }
}

// Gaussians on a square picture: middles [n,2] in pixels, inverse covariances [n,3] (xx, xy, yy), opacities, colours.
struct Splats {
    const float *centre, *conic, *opacity, *colour;
    int size;
};

constexpr float LEAST = 1.0f / 255;  // what covers less is left out
constexpr float MOST = 0.99f;

// Visits the pixels that Gaussian g covers by at least LEAST, with the place and the offset from its middle.
template <class Visit>
void each_pixel(const Splats& s, int64_t g, Visit visit) {
    if (!(s.opacity[g] > LEAST)) return;
    const float x = s.centre[2 * g], y = s.centre[2 * g + 1];
    const float xx = s.conic[3 * g], xy = s.conic[3 * g + 1], yy = s.conic[3 * g + 2];
    const float reach = 2 * std::log(s.opacity[g] / LEAST), area = xx * yy - xy * xy;
    const float tall = std::sqrt(reach * xx / area);
    const auto first = [&](float at) { return int(std::min(std::max(std::ceil(at - 0.5f), 0.0f), float(s.size))); };
    const auto last = [&](float at) { return int(std::min(std::max(std::floor(at + 0.5f), 0.0f), float(s.size))); };
    for (int row = first(y - tall); row < last(y + tall); ++row) {
        const float dy = row + 0.5f - y, middle = x - xy / xx * dy;
        const float half = std::sqrt(std::max(reach * xx - area * dy * dy, 0.0f)) / xx;
        for (int column = first(middle - half); column < last(middle + half); ++column)
            visit(row * s.size + column, column + 0.5f - x, dy);
    }
}

float fall(const Splats& s, int64_t g, float dx, float dy) {
    const float* c = s.conic + 3 * g;
    return std::exp(-0.5f * (c[0] * dx * dx + c[2] * dy * dy) - c[1] * dx * dy);
}

void draw(const Splats& s, int64_t g, float* image, double* left) {
    const float* colour = s.colour + 3 * g;
    each_pixel(s, g, [&](int pixel, float dx, float dy) {
        const float alpha = std::min(s.opacity[g] * fall(s, g, dx, dy), MOST);
        const float share = alpha * float(left[pixel]);
        for (int k = 0; k < 3; ++k) image[3 * pixel + k] += share * colour[k];
        left[pixel] *= 1 - alpha;
    });
}

// Goes backwards: `left` is what reaches behind Gaussian g, `after` the worth of all behind it. `grad` has 9 numbers:
// of the middle, the inverse covariance, the opacity and the colour.
void undraw(const Splats& s, int64_t g, const float* wanted, double* left, double* after, float* grad) {
    const float *c = s.conic + 3 * g, *colour = s.colour + 3 * g;
    double sums[9] = {};
    each_pixel(s, g, [&](int pixel, float dx, float dy) {
        const float falls = fall(s, g, dx, dy), raw = s.opacity[g] * falls, alpha = std::min(raw, MOST);
        const float* here = wanted + 3 * pixel;
        const double before = left[pixel] / (1 - alpha), share = alpha * before;
        const double worth = colour[0] * here[0] + colour[1] * here[1] + colour[2] * here[2];
        const double by_alpha = raw < MOST ? before * worth - after[pixel] / (1 - alpha) : 0;
        const double by_power = by_alpha * raw;
        const double parts[9] = {by_power * (c[0] * dx + c[1] * dy), by_power * (c[1] * dx + c[2] * dy),
                                 -0.5 * by_power * dx * dx, -by_power * dx * dy, -0.5 * by_power * dy * dy,
                                 by_alpha * falls, share * here[0], share * here[1], share * here[2]};
        for (int k = 0; k < 9; ++k) sums[k] += parts[k];
        left[pixel] = before;
        after[pixel] += share * worth;
    });
    for (int k = 0; k < 9; ++k) grad[k] = float(sums[k]);
}

}  // namespace

extern "C" {

// features [batch, count, channels] -> indices [batch, count, k] of the nearest others, in no particular order.
void densecloud_neighbours(const float* features, int64_t batch, int count, int channels, int k, int32_t* indices,
                           int threads) {
#pragma omp parallel for num_threads(threads) schedule(static) if (threads > 1)
    for (int64_t item = 0; item < batch; ++item)
        neighbours_of_item(features + item * count * channels, count, channels, k, indices + item * count * k);
}

// -> out [batch, count, 3, G]: maxima over the edges of c, b, a; argmax of the same shape. k <= 255.
void densecloud_edge_forward(const float* own_a, const float* own_b, const float* other, const float* ab,
                             const float* ac, const float* bc, const int32_t* indices, int64_t batch, int count, int k,
                             float* out, uint8_t* argmax, int threads) {
    const Weights weights(ab, ac, bc, false);
#pragma omp parallel for num_threads(threads) schedule(static) if (threads > 1)
    for (int64_t item = 0; item < batch; ++item) {
        const int64_t points = item * count;
        forward_of_item(own_a + points * G, own_b + points * G, other + points * G, weights, indices + points * k, count,
                        k, out + points * 3 * G, argmax + points * 3 * G);
    }
}

// Gradients are added to zeroed arrays: [batch, count, G] each, and [batch, G, G] for each matrix.
void densecloud_edge_backward(const float* own_a, const float* own_b, const float* other, const float* ab,
                              const float* ac, const float* bc, const int32_t* indices, const uint8_t* argmax,
                              const float* grad_out, int64_t batch, int count, int k, float* grad_own_a,
                              float* grad_own_b, float* grad_other, float* grad_ab, float* grad_ac, float* grad_bc,
                              int threads) {
    const Weights weights(ab, ac, bc, false), transposed(ab, ac, bc, true);
#pragma omp parallel for num_threads(threads) schedule(static) if (threads > 1)
    for (int64_t item = 0; item < batch; ++item) {
        const int64_t points = item * count;
        const Gradients gradients = {grad_own_a + points * G, grad_own_b + points * G, grad_other + points * G,
                                     grad_ab + item * G * G,  grad_ac + item * G * G,  grad_bc + item * G * G};
        backward_of_item(own_a + points * G, own_b + points * G, other + points * G, weights, transposed,
                         indices + points * k, argmax + points * 3 * G, grad_out + points * 3 * G, count, k, gradients);
    }
}

// points [batch, count, 3], others [batch, other_count, 3] -> the index of the nearest other of each point.
void densecloud_nearest(const float* points, const float* others, int64_t batch, int count, int other_count,
                        int64_t* indices, int threads) {
#pragma omp parallel for num_threads(threads) schedule(static) if (threads > 1)
    for (int64_t item = 0; item < batch; ++item)
        nearest_of_item(points + item * count * 3, count, others + item * other_count * 3, other_count,
                        indices + item * count);
}

// Gaussians [n,...] drawn in an order, front to back -> image [size,size,3], zeroed before, and left [size,size], ones
// before: what is still let through.
void densecloud_splats_forward(const float* centre, const float* conic, const float* opacity, const float* colour,
                               const int64_t* order, int64_t count, int size, float* image, double* left) {
    const Splats splats = {centre, conic, opacity, colour, size};
    for (int64_t i = 0; i < count; ++i) draw(splats, order[i], image, left);
}

// `left` as the above left it, `after` [size,size] the worth of what is behind all; both are used up. Gradients go to
// zeroed grad [n,9].
void densecloud_splats_backward(const float* centre, const float* conic, const float* opacity, const float* colour,
                                const int64_t* order, int64_t count, int size, const float* wanted, double* left,
                                double* after, float* grad) {
    const Splats splats = {centre, conic, opacity, colour, size};
    for (int64_t i = count - 1; i >= 0; --i) undraw(splats, order[i], wanted, left, after, grad + 9 * order[i]);
}
}

/* The dynamics network of `study.models.networks.dynamics`, unrolled over a whole horizon, forwards
   and backwards. `unroll.py` has the equations.

   The trajectories of a batch are independent. So a block of ROWS trajectories runs through the
   whole horizon at once, and its state and the weights stay in the nearest caches. Each step is a
   few matrix products of a few rows (`product`). The pointwise operations follow while the result
   is still in the cache. The gradients of the weights are sums over steps and rows; the caller
   computes them from `tape` and `gradients`.

   Arrays are float32 in row-major order. The leading axis M is that of independent networks, each
   with its own weights. A row adds its products in the same order for every batch size, so a
   forecast does not depend on the other forecasts of the batch. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef __AVX512F__
#define LANES 16
#else
#define LANES 8
#endif
#define WIDE (2 * LANES) /* columns of a tile: two vectors */
#define TALL 6           /* rows of a tile: with WIDE columns, twelve registers of sums */
#define ROWS 12          /* rows that go through the horizon together */

typedef float vec __attribute__((vector_size(4 * LANES), aligned(4), may_alias));
typedef int32_t ivec __attribute__((vector_size(4 * LANES), aligned(4), may_alias));

static inline long padded(long columns) { return (columns + WIDE - 1) / WIDE * WIDE; }

static inline vec choose(ivec where, vec yes, vec no)
{
    return (vec)((where & (ivec)yes) | (~where & (ivec)no));
}

/* exp by 2^k times a polynomial on [-ln 2 / 2, ln 2 / 2]: relative error about 1e-7. */
static inline vec exponential(vec x)
{
    const vec zero = {0};
    x = choose(x > 88.0f, zero + 88.0f, choose(x < -87.0f, zero - 87.0f, x));
    const vec shifted = x * 1.44269504f + 12582912.0f; /* rounds to an integer k */
    const vec k = shifted - 12582912.0f;
    const vec f = (x - k * 0.693359375f) + k * 2.12194440e-4f;
    vec p = zero + 1.9875691500e-4f;
    p = p * f + 1.3981999507e-3f;
    p = p * f + 8.3334519073e-3f;
    p = p * f + 4.1665795894e-2f;
    p = p * f + 1.6666665459e-1f;
    p = p * f + 5.0000001201e-1f;
    p = p * (f * f) + f + 1.0f;
    const ivec scale = ((ivec)shifted << 23) + 0x3f800000;
    return p * (vec)scale;
}

static inline vec sigmoid(vec x) { return 1.0f / (1.0f + exponential(-x)); }
static inline vec hyperbolic_tangent(vec x) { return 1.0f - 2.0f / (1.0f + exponential(2.0f * x)); }
static inline vec silu(vec x) { return x * sigmoid(x); }

/* The derivative of `silu`. */
static inline vec silu_slope(vec x)
{
    const vec s = sigmoid(x);
    return s * (1.0f + x * (1.0f - s));
}

static inline vec load(const float *from) { return *(const vec *)from; }
static inline void store(vec value, float *to) { *(vec *)to = value; }

/* right [depth, columns] in strips of WIDE columns, each strip's rows one after the other. */
static void pack(const float *right, long depth, long columns, long row, long column, float *packed)
{
    for (long strip = 0; strip < padded(columns); strip += WIDE)
        for (long k = 0; k < depth; k++)
            for (long j = strip; j < strip + WIDE; j++)
                *packed++ = j < columns ? right[k * row + j * column] : 0.0f;
}

static inline __attribute__((always_inline)) void tile(
    const int rows, long depth, const float *left, long left_row, const float *packed, float *sums,
    long sums_row)
{
    vec a[TALL], b[TALL];
    for (int i = 0; i < rows; i++) {
        a[i] = *(const vec *)(sums + i * sums_row);
        b[i] = *(const vec *)(sums + i * sums_row + LANES);
    }
    for (long k = 0; k < depth; k++) {
        const vec first = *(const vec *)(packed + k * WIDE);
        const vec second = *(const vec *)(packed + k * WIDE + LANES);
        for (int i = 0; i < rows; i++) {
            const float factor = left[i * left_row + k];
            a[i] += factor * first;
            b[i] += factor * second;
        }
    }
    for (int i = 0; i < rows; i++) {
        *(vec *)(sums + i * sums_row) = a[i];
        *(vec *)(sums + i * sums_row + LANES) = b[i];
    }
}

/* sums [rows, columns] += left [rows, depth] · right, which is packed. */
static void product(
    long rows, long depth, long columns, const float *left, long left_row, const float *packed,
    float *sums, long sums_row)
{
    for (long strip = 0; strip < columns; strip += WIDE, packed += depth * WIDE) {
        long i = 0;
        for (; i + TALL <= rows; i += TALL)
            tile(TALL, depth, left + i * left_row, left_row, packed, sums + i * sums_row + strip,
                 sums_row);
        const float *rest = left + i * left_row;
        float *into = sums + i * sums_row + strip;
        switch (rows - i) {
        case 5: tile(5, depth, rest, left_row, packed, into, sums_row); break;
        case 4: tile(4, depth, rest, left_row, packed, into, sums_row); break;
        case 3: tile(3, depth, rest, left_row, packed, into, sums_row); break;
        case 2: tile(2, depth, rest, left_row, packed, into, sums_row); break;
        case 1: tile(1, depth, rest, left_row, packed, into, sums_row); break;
        }
    }
}

static float *zeros(long count)
{
    float *memory = calloc(count + WIDE, sizeof(float));
    if (!memory) abort();
    return memory;
}

typedef struct {
    long batch, steps; /* B and T */
    long state;        /* D */
    long angles;       /* K */
    long stem;         /* P */
    long memory;       /* H */
    long layers;       /* L */
    float decay;       /* factor on the gradient of a state, at every step back */
    float bound;       /* of the log standard deviation of additive noise */
} Sizes;

/* The leading axis of all weights is M. With F = D + 4K, O = D + 2P + 3H and width W = P, or H
   without a stem. The columns of `state` are the output l, the stem's u and v, and the gates n, r
   and u; those of `hidden` are r, u and n. */
typedef struct {
    const float *state;        /* [F, O] */
    const float *gates;        /* [P, 3H] */
    const float *hidden;       /* [H, 3H] */
    const float *hidden_bias;  /* [H] */
    const float *mix;          /* [H + P, P], with stem and memory */
    const float *mix_bias;     /* [P] */
    const float *layers;       /* [L, W, W] */
    const float *layers_bias;  /* [L, W] */
    const float *output;       /* [W, D] */
    const float *noise_output; /* [W, D], or null without gains */
    const float *log_std;      /* [W, D], or null without noise */
    const float *log_std_bias; /* [D] */
    /* without the axis M: */
    const float *lowest, *highest;         /* [D] */
    const float *angle_mean, *angle_scale; /* [K] */
    const int64_t *angle_columns;          /* [K] */
} Weights;

/* What the forward pass reads: terms [M, B, T, O], state [M, B, D], hidden [M, B, H]. With
   multiplicative noise gain [M, B, T, W], with additive noise noise [M, B, T, D]; else null. */
typedef struct {
    const float *terms, *state, *hidden, *gain, *noise;
} Inputs;

/* Offsets of a step's values in `tape`: features f [F], h_t [H], h_{t+1} [H], p [P], u [P], v [P],
   the gates r, u, n and g_n [4H], y_0 … y_L [L + 1, W] and the layers' sums [L, W]. */
typedef struct {
    long features, before, after, stem, u, v, gates, top, sums, size;
} Tape;

/* Offsets of a step's values in `gradients`: the gradients of the terms [O] and of g_n [H], which
   follow each other, of the mix [P] and of the layers' sums [L, W]. */
typedef struct {
    long terms, stem, gates, mix, sums, size;
} Gradients;

typedef struct {
    long D, K, P, H, L, F, O, W;
    Tape tape;
    Gradients gradients;
} Layout;

static Layout layout(const Sizes *sizes)
{
    Layout n = {.D = sizes->state, .K = sizes->angles, .P = sizes->stem, .H = sizes->memory,
                .L = sizes->layers};
    n.F = n.D + 4 * n.K;
    n.O = n.D + 2 * n.P + 3 * n.H;
    n.W = n.P ? n.P : n.H;
    Tape *tape = &n.tape;
    tape->before = n.F;
    tape->after = tape->before + n.H;
    tape->stem = tape->after + n.H;
    tape->u = tape->stem + n.P;
    tape->v = tape->u + n.P;
    tape->gates = tape->v + n.P;
    tape->top = tape->gates + 4 * n.H;
    tape->sums = tape->top + (n.L + 1) * n.W;
    tape->size = tape->sums + n.L * n.W;
    n.gradients.stem = n.D;
    n.gradients.gates = n.D + 2 * n.P;
    n.gradients.mix = n.O + n.H;
    n.gradients.sums = n.gradients.mix + n.P;
    n.gradients.size = n.gradients.sums + n.L * n.W;
    return n;
}

static void copy(long count, const float *from, float *to)
{
    memcpy(to, from, count * sizeof(float));
}

/* f = [s, sin ψ, cos ψ, sin 2ψ, cos 2ψ] for the angles ψ of a state. */
static void features(const Layout *n, const Weights *weights, const float *state, float *f)
{
    copy(n->D, state, f);
    for (long k = 0; k < n->K; k++) {
        const float angle =
            state[weights->angle_columns[k]] * weights->angle_scale[k] + weights->angle_mean[k];
        const float s = sinf(angle), c = cosf(angle);
        float *values = f + n->D + k;
        values[0] = s;
        values[n->K] = c;
        values[2 * n->K] = 2 * s * c;
        values[3 * n->K] = c * c - s * s;
    }
}

/* h_{t+1} from the sums x_n, r, u and g_n of a row, which `gates` replaces by r, u, n and g_n. */
static void advance(long H, const float *sums, float *gates, long stride, float *h)
{
    for (long j = 0; j < H; j += LANES) {
        const vec r = sigmoid(load(sums + H + j)), u = sigmoid(load(sums + 2 * H + j));
        const vec g = load(sums + 3 * H + j);
        const vec n = hyperbolic_tangent(load(sums + j) + r * g);
        store(r, gates + j);
        store(u, gates + stride + j);
        store(n, gates + 2 * stride + j);
        store(g, gates + 3 * stride + j);
        store(n + u * (load(h + j) - n), h + j);
    }
}

/* The forward pass of the blocks first … last - 1. There are M · ceil(B / ROWS) blocks.

   Writes states [M, B, T, D]. Writes tops y_L [M, B, T, W] and, for the backward pass, tape
   [M, B, T, `tape.size`], unless they are null. */
void forward(
    long first, long last, const Sizes *sizes, const Weights *weights, const Inputs *inputs,
    float *states, float *tops, float *tape)
{
    const Layout n = layout(sizes);
    const long batch = sizes->batch, steps = sizes->steps, blocks = (batch + ROWS - 1) / ROWS;
    const long D = n.D, P = n.P, H = n.H, L = n.L, F = n.F, O = n.O, W = n.W;
    const int has_mix = H && P;
    const float bound = sizes->bound;
    const long HH = padded(H), WW = padded(W), DD = padded(D);
    const long sums_row = padded(O + H) + WIDE, hp_row = padded(H + P) + WIDE, f_row = padded(F);
    float *by_state = zeros(F * padded(O)), *by_stem = zeros(P * padded(3 * H));
    float *by_hidden = zeros(H * padded(3 * H)), *by_mix = zeros((H + P) * padded(P));
    float *by_layer = zeros(L * W * WW), *by_output = zeros(W * DD);
    float *by_noise = zeros(W * DD), *by_log_std = zeros(W * DD);
    float *f = zeros(ROWS * f_row), *sums = zeros(ROWS * sums_row), *hp = zeros(ROWS * hp_row);
    float *h = zeros(ROWS * HH), *gates = zeros(ROWS * 4 * HH), *top = zeros(ROWS * WW);
    float *a = zeros(ROWS * WW), *s = zeros(ROWS * DD), *w = zeros(ROWS * DD);
    long packed = -1;
    for (long index = first; index < last; index++) {
        const long m = index / blocks, row = index % blocks * ROWS;
        const long rows = batch - row < ROWS ? batch - row : ROWS;
        if (m != packed) {
            pack(weights->state + m * F * O, F, O, O, 1, by_state);
            if (has_mix) pack(weights->gates + m * P * 3 * H, P, 3 * H, 3 * H, 1, by_stem);
            if (H) pack(weights->hidden + m * H * 3 * H, H, 3 * H, 3 * H, 1, by_hidden);
            if (has_mix) pack(weights->mix + m * (H + P) * P, H + P, P, P, 1, by_mix);
            for (long i = 0; i < L; i++)
                pack(weights->layers + (m * L + i) * W * W, W, W, W, 1, by_layer + i * W * WW);
            if (D) pack(weights->output + m * W * D, W, D, D, 1, by_output);
            if (inputs->gain) pack(weights->noise_output + m * W * D, W, D, D, 1, by_noise);
            if (inputs->noise) pack(weights->log_std + m * W * D, W, D, D, 1, by_log_std);
            packed = m;
        }
        for (long i = 0; i < rows; i++) {
            const long r = m * batch + row + i;
            copy(H, inputs->hidden + r * H, h + i * HH);
            copy(D, inputs->state + r * D, s + i * DD);
        }
        for (long t = 0; t < steps; t++) {
            for (long i = 0; i < rows; i++) {
                const long at = (m * batch + row + i) * steps + t;
                float *row_sums = sums + i * sums_row;
                features(&n, weights, s + i * DD, f + i * f_row);
                copy(O, inputs->terms + at * O, row_sums);
                if (H) copy(H, weights->hidden_bias + m * H, row_sums + O);
                if (tape) copy(H, h + i * HH, tape + at * n.tape.size + n.tape.before);
            }
            product(rows, F, O, f, f_row, by_state, sums, sums_row);
            for (long i = 0; i < rows; i++) {
                float *u = sums + i * sums_row + D, *p = hp + i * hp_row + H;
                for (long j = 0; j < P; j += LANES)
                    store(load(u + j) * silu(load(u + P + j)), p + j);
            }
            if (H) {
                if (P) product(rows, P, 3 * H, hp + H, hp_row, by_stem, sums + D + 2 * P, sums_row);
                product(rows, H, 3 * H, h, HH, by_hidden, sums + D + 2 * P + H, sums_row);
            }
            for (long i = 0; i < rows; i++) {
                float *row_hp = hp + i * hp_row;
                float *row_gates = gates + i * 4 * HH, *row_top = top + i * WW;
                if (H) advance(H, sums + i * sums_row + D + 2 * P, row_gates, HH, h + i * HH);
                copy(H, h + i * HH, row_hp);
                copy(W, P ? row_hp + H : row_hp, row_top);
                if (has_mix)
                    for (long j = 0; j < P; j++) row_top[j] += weights->mix_bias[m * P + j];
            }
            if (has_mix) product(rows, H + P, P, hp, hp_row, by_mix, top, WW);
            for (long i = 0; tape && i < rows; i++) {
                float *step = tape + ((m * batch + row + i) * steps + t) * n.tape.size;
                copy(F, f + i * f_row, step);
                copy(H + P, hp + i * hp_row, step + n.tape.after);
                copy(2 * P, sums + i * sums_row + D, step + n.tape.u);
                for (long k = 0; k < 4; k++)
                    copy(H, gates + (4 * i + k) * HH, step + n.tape.gates + k * H);
                copy(W, top + i * WW, step + n.tape.top);
            }
            for (long layer = 0; layer < L; layer++) {
                for (long i = 0; i < rows; i++)
                    copy(W, weights->layers_bias + (m * L + layer) * W, a + i * WW);
                product(rows, W, W, top, WW, by_layer + layer * W * WW, a, WW);
                for (long i = 0; i < rows; i++) {
                    float *row_top = top + i * WW, *row_a = a + i * WW;
                    for (long j = 0; j < W; j += LANES)
                        store(load(row_top + j) + silu(load(row_a + j)), row_top + j);
                    if (!tape) continue;
                    float *step = tape + ((m * batch + row + i) * steps + t) * n.tape.size;
                    copy(W, row_a, step + n.tape.sums + layer * W);
                    copy(W, row_top, step + n.tape.top + (layer + 1) * W);
                }
            }
            for (long i = 0; i < rows; i++) {
                const long at = (m * batch + row + i) * steps + t;
                if (tops) copy(W, top + i * WW, tops + at * W);
                copy(D, sums + i * sums_row, s + i * DD);
                if (inputs->noise) copy(D, weights->log_std_bias + m * D, w + i * DD);
                const float *gain = inputs->gain ? inputs->gain + at * W : 0;
                for (long j = 0; gain && j < W; j++) a[i * WW + j] = top[i * WW + j] * gain[j];
            }
            if (!D) continue;
            product(rows, W, DD, top, WW, by_output, s, DD);
            if (inputs->gain) product(rows, W, DD, a, WW, by_noise, s, DD);
            if (inputs->noise) product(rows, W, DD, top, WW, by_log_std, w, DD);
            for (long i = 0; i < rows; i++) {
                const long at = (m * batch + row + i) * steps + t;
                float *row_s = s + i * DD, *row_w = w + i * DD;
                for (long j = 0; inputs->noise && j < DD; j += LANES)
                    store(exponential(bound * hyperbolic_tangent(load(row_w + j) / bound)), row_w + j);
                for (long j = 0; inputs->noise && j < D; j++)
                    row_s[j] += row_w[j] * inputs->noise[at * D + j];
                for (long j = 0; j < D; j++) {
                    row_s[j] = row_s[j] > weights->highest[j] ? weights->highest[j] : row_s[j];
                    row_s[j] = row_s[j] < weights->lowest[j] ? weights->lowest[j] : row_s[j];
                }
                copy(D, row_s, states + at * D);
            }
        }
    }
    float *all[] = {by_state, by_stem, by_hidden, by_mix, by_layer, by_output, by_noise, by_log_std,
                    f, sums, hp, h, gates, top, a, s, w};
    for (unsigned i = 0; i < sizeof all / sizeof *all; i++) free(all[i]);
}

/* The chain rule through the gates. `grad_h` holds the gradient of h_{t+1}. Writes the gradients of
   the sums x_n, r, u and g_n. Replaces `grad_h` by the direct part of the gradient of h_t. */
static void through_gates(
    long H, const float *restrict gates, const float *restrict before, float *restrict grad_h,
    float *restrict sums)
{
    for (long j = 0; j < H; j++) {
        const float r = gates[j], u = gates[H + j], n = gates[2 * H + j], g = gates[3 * H + j];
        const float grad_n = grad_h[j] * (1 - u) * (1 - n * n);
        sums[j] = grad_n;
        sums[H + j] = grad_n * g * r * (1 - r);
        sums[2 * H + j] = grad_h[j] * (before[j] - n) * u * (1 - u);
        sums[3 * H + j] = grad_n * r;
        grad_h[j] *= u;
    }
}

/* The gradient of a state [D] from that of its features [F]. */
static void through_features(
    const Layout *n, const Weights *weights, float decay, const float *f, const float *grad_f,
    float *grad_s)
{
    for (long j = 0; j < n->D; j++) grad_s[j] = decay * grad_f[j];
    for (long k = 0; k < n->K; k++) {
        const float *value = f + n->D + k, *grad = grad_f + n->D + k;
        const long K = n->K;
        const float slope = value[K] * grad[0] - value[0] * grad[K]
                            + 2 * (value[3 * K] * grad[2 * K] - value[2 * K] * grad[3 * K]);
        grad_s[weights->angle_columns[k]] += decay * weights->angle_scale[k] * slope;
    }
}

/* The backward pass, from the last step to the first. Sizes and blocks are those of `forward`.

   Reads states and tape, and the gradients of the results, grad_states [M, B, T, D] and grad_tops
   [M, B, T, W]; either may be null. Writes gradients [M, B, T, `gradients.size`], grad_gain
   [M, B, T, W] where there are gains, grad_state [M, B, D] and grad_hidden [M, B, H]. */
void backward(
    long first, long last, const Sizes *sizes, const Weights *weights, const Inputs *inputs,
    const float *states, const float *tape, const float *grad_states, const float *grad_tops,
    float *gradients, float *grad_gain, float *grad_state, float *grad_hidden)
{
    const Layout n = layout(sizes);
    const long batch = sizes->batch, steps = sizes->steps, blocks = (batch + ROWS - 1) / ROWS;
    const long D = n.D, P = n.P, H = n.H, L = n.L, F = n.F, O = n.O, W = n.W;
    const int has_mix = H && P;
    const long HH = padded(H), WW = padded(W), DD = padded(D), FF = padded(F);
    const long hp_row = padded(H + P) + WIDE, g_row = padded(n.gradients.size) + WIDE;
    float *by_state = zeros(O * FF), *by_stem = zeros(3 * H * padded(P));
    float *by_hidden = zeros(3 * H * HH), *by_mix = zeros(P * padded(H + P));
    float *by_layer = zeros(L * W * WW), *by_output = zeros(D * WW), *by_noise = zeros(D * WW);
    float *g = zeros(ROWS * g_row), *hp = zeros(ROWS * hp_row), *grad_f = zeros(ROWS * FF);
    float *grad_h = zeros(ROWS * HH), *grad_s = zeros(ROWS * DD), *top = zeros(ROWS * WW);
    float *q = zeros(ROWS * WW), *u = zeros(padded(P)), *v = zeros(padded(P));
    long packed = -1;
    for (long index = first; index < last; index++) {
        const long m = index / blocks, row = index % blocks * ROWS;
        const long rows = batch - row < ROWS ? batch - row : ROWS;
        if (m != packed) { /* transposes of the weights */
            pack(weights->state + m * F * O, O, F, 1, O, by_state);
            if (has_mix) pack(weights->gates + m * P * 3 * H, 3 * H, P, 1, 3 * H, by_stem);
            if (H) pack(weights->hidden + m * H * 3 * H, 3 * H, H, 1, 3 * H, by_hidden);
            if (has_mix) pack(weights->mix + m * (H + P) * P, P, H + P, 1, P, by_mix);
            for (long i = 0; i < L; i++)
                pack(weights->layers + (m * L + i) * W * W, W, W, 1, W, by_layer + i * W * WW);
            if (D) pack(weights->output + m * W * D, D, W, 1, D, by_output);
            if (inputs->gain) pack(weights->noise_output + m * W * D, D, W, 1, D, by_noise);
            packed = m;
        }
        memset(grad_h, 0, ROWS * HH * sizeof(float));
        memset(grad_s, 0, ROWS * DD * sizeof(float));
        for (long t = steps - 1; t >= 0; t--) {
            for (long i = 0; i < rows; i++) {
                const long at = (m * batch + row + i) * steps + t;
                float *row_s = grad_s + i * DD, *row_top = top + i * WW;
                memset(row_top, 0, WW * sizeof(float));
                if (grad_tops) copy(W, grad_tops + at * W, row_top);
                for (long j = 0; j < D; j++) {
                    const float s = states[at * D + j];
                    if (grad_states) row_s[j] += grad_states[at * D + j];
                    if (s <= weights->lowest[j] || s >= weights->highest[j]) row_s[j] = 0;
                }
                copy(D, row_s, g + i * g_row);
            }
            if (D) product(rows, D, WW, grad_s, DD, by_output, top, WW);
            if (inputs->gain) {
                memset(q, 0, ROWS * WW * sizeof(float));
                product(rows, D, WW, grad_s, DD, by_noise, q, WW);
                for (long i = 0; i < rows; i++) {
                    const long at = (m * batch + row + i) * steps + t;
                    const float *step = tape + at * n.tape.size + n.tape.top + L * W;
                    for (long j = 0; j < W; j++) {
                        top[i * WW + j] += q[i * WW + j] * inputs->gain[at * W + j];
                        grad_gain[at * W + j] = q[i * WW + j] * step[j];
                    }
                }
            }
            for (long layer = L - 1; layer >= 0; layer--) {
                for (long i = 0; i < rows; i++) {
                    const long at = (m * batch + row + i) * steps + t;
                    const float *sums = tape + at * n.tape.size + n.tape.sums + layer * W;
                    float *into = q + i * WW;
                    copy(W, sums, into); /* a vector may reach past the end of the tape */
                    for (long j = 0; j < W; j += LANES)
                        store(load(top + i * WW + j) * silu_slope(load(into + j)), into + j);
                    copy(W, into, g + i * g_row + n.gradients.sums + layer * W);
                }
                product(rows, W, WW, g + n.gradients.sums + layer * W, g_row,
                        by_layer + layer * W * WW, top, WW);
            }
            memset(hp, 0, ROWS * hp_row * sizeof(float));
            for (long i = 0; i < rows; i++) {
                copy(W, top + i * WW, hp + i * hp_row + (P ? H : 0));
                if (has_mix) copy(P, top + i * WW, g + i * g_row + n.gradients.mix);
            }
            if (has_mix) product(rows, P, H + P, top, WW, by_mix, hp, hp_row);
            for (long i = 0; H && i < rows; i++) {
                const float *step = tape + ((m * batch + row + i) * steps + t) * n.tape.size;
                float *row_h = grad_h + i * HH;
                for (long j = 0; j < H; j++) row_h[j] += hp[i * hp_row + j];
                through_gates(H, step + n.tape.gates, step + n.tape.before, row_h,
                              g + i * g_row + n.gradients.gates);
            }
            if (H) {
                product(rows, 3 * H, H, g + n.gradients.gates + H, g_row, by_hidden, grad_h, HH);
                if (P)
                    product(rows, 3 * H, P, g + n.gradients.gates, g_row, by_stem, hp + H, hp_row);
            }
            for (long i = 0; P && i < rows; i++) {
                const float *step = tape + ((m * batch + row + i) * steps + t) * n.tape.size;
                copy(P, step + n.tape.u, u); /* a vector may reach past the end of the tape */
                copy(P, step + n.tape.v, v);
                const float *grad_p = hp + i * hp_row + H;
                float *grad_u = q + i * WW, *row_g = g + i * g_row + n.gradients.stem;
                for (long j = 0; j < P; j += LANES)
                    store(load(grad_p + j) * silu(load(v + j)), grad_u + j);
                copy(P, grad_u, row_g);
                for (long j = 0; j < P; j += LANES)
                    store(load(grad_p + j) * load(u + j) * silu_slope(load(v + j)), grad_u + j);
                copy(P, grad_u, row_g + P);
            }
            memset(grad_f, 0, ROWS * FF * sizeof(float));
            product(rows, O, F, g, g_row, by_state, grad_f, FF);
            for (long i = 0; i < rows; i++) {
                const long at = (m * batch + row + i) * steps + t;
                through_features(&n, weights, sizes->decay, tape + at * n.tape.size,
                                 grad_f + i * FF, grad_s + i * DD);
                copy(n.gradients.size, g + i * g_row, gradients + at * n.gradients.size);
            }
        }
        for (long i = 0; i < rows; i++) {
            const long r = m * batch + row + i;
            copy(H, grad_h + i * HH, grad_hidden + r * H);
            copy(D, grad_s + i * DD, grad_state + r * D);
        }
    }
    float *all[] = {by_state, by_stem, by_hidden, by_mix, by_layer, by_output, by_noise, g, hp,
                    grad_f, grad_h, grad_s, top, q, u, v};
    for (unsigned i = 0; i < sizeof all / sizeof *all; i++) free(all[i]);
}

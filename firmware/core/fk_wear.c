#include "fk_wear.h"

#include "fk_route.h"

#define FK_WEAR_FADING 0.96f        /* forgetting factor of each period: an older one has half its weight after 17 */
#define FK_WEAR_PENALTY 9.0f        /* what a limb or the current must explain to be selected: three standard deviations */
#define FK_WEAR_COMMON_BY 9.0f      /* how much more than one limb a share that all limbs have lost must explain; */
#define FK_WEAR_COMMON_MOST 0.6f    /* its largest value: a robot that loses more at once has another fault */
#define FK_WEAR_OUTLIER 8.0f        /* beyond this squared error a limb may have broken, and what older periods say of limbs */
#define FK_WEAR_OUTLIER_FADING 0.3f /* keeps this much of its weight; what they say of the current keeps all of it */
#define FK_WEAR_ERROR_MOST 1e6f     /* a period of larger squared error, or of NaN, is not learned from */
#define FK_WEAR_SECANT 22937u       /* a wear curve is replaced by its secant from 0 to this share (0.7), or to the
                                       estimated one if that is larger */
#define FK_WEAR_LEAST 0.02f         /* plausible shares; above 1 the end of the curve is meant */
#define FK_WEAR_MOST 1.3f
#define FK_WEAR_RESTARTED 18.0f     /* what a share explains after a restart: twice the penalty, so that it is no longer
                                       selected after 17 periods that say nothing of its limb */
#define FK_WEAR_GONE_BY 1.0f        /* by how much more squared error of a period a limb is taken to do nothing, or no longer */
#define FK_WEAR_APART 1e-3f         /* share of an unknown's information that must be independent of the selected ones */

/* Variance of a period's prediction error if wear and current are known, for each axis: (1.2 mm)^2, (1.2 mm)^2,
 * (0.02 rad)^2. */
static const float noise[3] = {1.44e-6f, 1.44e-6f, 4e-4f};
/* Prior information on a current: 1 / variance, of 3 mm/s, 3 mm/s, 0.005 rad/s. */
static const float current_information[3] = {111111.11f, 111111.11f, 40000.0f};
static const uint8_t variance_of[3] = {0u, 0u, 1u};

/* The normal equations of all unknowns, with the right-hand side as last column. Gauss-Jordan elimination of an
 * unknown leaves its value in its own row, and takes what it explains out of the other rows. The last unknown is a
 * share that all limbs have lost, as from an empty battery; a limb's own unknown is then what it has lost beyond it. */
typedef struct {
    float at[FK_WEAR_UNKNOWNS + 1u][FK_WEAR_UNKNOWNS + 2u];
    uint32_t unknowns;
    uint32_t common; /* the last unknown */
    uint32_t chosen; /* bit i: unknown i is selected, so eliminated */
} fk_normal_t;

void fk_wear_use(fk_wear_t *wear, fk_tables_t *tables)
{
    uint32_t any = 0u;
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        any |= wear->lost[limb];
    }
    tables->worn = 0;
    if (any != 0u) {
        fk_wear_shift(tables, wear->lost, wear->shift);
        tables->worn = wear->shift;
    }
}

int32_t fk_wear_lacks_a_limb(const fk_wear_t *wear)
{
    int32_t lacks = 0;
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        lacks |= (wear->lost[limb] >= FK_WEAR_GONE) ? 1 : 0;
    }
    return lacks;
}

static float lost_share(uint32_t lost) { return (float)lost / (float)FK_LOST_MAX; }

void fk_wear_restart(fk_wear_t *wear)
{
    for (uint32_t i = 0u; i < FK_WEAR_SUMS; ++i) {
        wear->information[i] = 0.0f;
    }
    for (uint32_t i = 0u; i < FK_WEAR_UNKNOWNS; ++i) {
        wear->vector[i] = 0.0f;
    }
    for (uint32_t i = 0u; i < 3u; ++i) {
        wear->current[i] = 0.0f;
    }
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        if (wear->lost[limb] > 0u) {
            const uint32_t at = 3u + limb;
            const float share = lost_share(wear->lost[limb]);
            const float information = FK_WEAR_RESTARTED / (share * share);
            wear->information[at * (at + 3u) / 2u] = information;
            wear->vector[at] = information * share;
        }
    }
}

void fk_wear_init(fk_wear_t *wear, fk_tables_t *tables, uint8_t learn)
{
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        wear->lost[limb] = 0u;
    }
    fk_wear_restart(wear);
    wear->learn = (tables->wear_knots > 0u) ? learn : (uint8_t)FK_LEARN_OFF;
    fk_wear_use(wear, tables);
}

/* How a limb that has lost a share changes a motion. */
static void curve(const fk_tables_t *tables, uint32_t limb, uint32_t lost, float motion[3])
{
    int32_t codes[6];
    fk_wear_curve(tables, limb, lost, codes);
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        motion[axis] = (float)codes[axis] * tables->motion_scale[axis];
    }
}

/* Bit i: limb i fires in the action. */
static uint32_t fires_of(const fk_tables_t *tables, uint32_t action)
{
    const uint8_t *masks = tables->action_rows + 4u * action;
    return (uint32_t)masks[1] | (uint32_t)masks[2];
}

/* The error that tables of new limbs would have made, in the body frame, and its derivatives row[axis][unknown]. */
static void regression(const fk_wear_t *wear, const fk_tables_t *tables, const fk_wear_period_t *period, float error[3],
                    float row[3][FK_WEAR_UNKNOWNS])
{
    const uint32_t fires = fires_of(tables, period->action);
    float sine;
    float cosine;
    fk_sincos(period->heading_rad, &sine, &cosine);
    error[0] = cosine * period->error[0] + sine * period->error[1];
    error[1] = cosine * period->error[1] - sine * period->error[0];
    error[2] = period->error[2];
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        for (uint32_t i = 0u; i < FK_WEAR_UNKNOWNS; ++i) {
            row[axis][i] = 0.0f;
        }
    }
    row[0][0] = cosine * period->period_s;
    row[0][1] = sine * period->period_s;
    row[1][0] = -sine * period->period_s;
    row[1][1] = cosine * period->period_s;
    row[2][2] = period->period_s;
    for (uint32_t limb = 0u; limb < tables->limbs; ++limb) {
        if (((fires >> limb) & 1u) != 0u) {
            const uint32_t lost = wear->lost[limb];
            const uint32_t to = (lost > FK_WEAR_SECANT) ? lost : FK_WEAR_SECANT;
            float changes[3];
            curve(tables, limb, lost, changes);
            for (uint32_t axis = 0u; axis < 3u; ++axis) {
                error[axis] += changes[axis];
            }
            curve(tables, limb, to, changes);
            for (uint32_t axis = 0u; axis < 3u; ++axis) {
                row[axis][3u + limb] = changes[axis] / lost_share(to);
            }
        }
    }
}

static void eliminate(fk_normal_t *normal, uint32_t pivot)
{
    float *const own = normal->at[pivot];
    const float by = own[pivot];
    for (uint32_t j = 0u; j <= normal->unknowns; ++j) {
        own[j] = own[j] / by;
    }
    for (uint32_t i = 0u; i < normal->unknowns; ++i) {
        if (i != pivot) {
            const float part = normal->at[i][pivot];
            for (uint32_t j = 0u; j <= normal->unknowns; ++j) {
                normal->at[i][j] = normal->at[i][j] - part * own[j];
            }
        }
    }
    normal->chosen |= 1u << pivot;
}

static int32_t is_plausible(float share) { return share > FK_WEAR_LEAST && share < FK_WEAR_MOST; }

static int32_t is_chosen(const fk_normal_t *normal, uint32_t unknown)
{
    return (int32_t)((normal->chosen >> unknown) & 1u);
}

/* The value of a selected unknown, if those from `first` on take these values. */
static float value_if(const fk_normal_t *normal, uint32_t unknown, uint32_t first, uint32_t count, const float *values)
{
    float value = normal->at[unknown][normal->unknowns];
    for (uint32_t k = 0u; k < count; ++k) {
        value = value - normal->at[unknown][first + k] * values[k];
    }
    return value;
}

/* Whether the selected limbs keep plausible shares if the unknowns from `first` on take these values. */
static int32_t are_plausible(const fk_normal_t *normal, uint32_t first, uint32_t count, const float *values)
{
    float common = 0.0f;
    if (is_chosen(normal, normal->common) != 0) {
        common = value_if(normal, normal->common, first, count, values);
        if (!is_plausible(common) || common > FK_WEAR_COMMON_MOST) {
            return 0;
        }
    }
    for (uint32_t i = 3u; i < normal->common; ++i) {
        if (is_chosen(normal, i) != 0 && !is_plausible(common + value_if(normal, i, first, count, values))) {
            return 0;
        }
    }
    return 1;
}

/* What a limb, or all limbs, explain of the residual of the selected unknowns; -1 if the data cannot separate it from
 * them, or if a share would be implausible. */
static float gain_of_share(const fk_normal_t *normal, uint32_t at, float information)
{
    const float left = normal->at[at][at];
    if (!(left > FK_WEAR_APART * information)) { /* it has not fired, or always with the others */
        return -1.0f;
    }
    const float value = normal->at[at][normal->unknowns] / left;
    float share = value;
    if (is_chosen(normal, normal->common) != 0) {
        share = value_if(normal, normal->common, at, 1u, &value) + value;
    }
    if (!is_plausible(share) || !are_plausible(normal, at, 1u, &value) ||
        (at == normal->common && value > FK_WEAR_COMMON_MOST)) {
        return -1.0f;
    }
    return normal->at[at][normal->unknowns] * value;
}

/* The same for the current, by Gaussian elimination of its three unknowns. Its prior information keeps each pivot
 * positive. */
static float gain_of_current(const fk_normal_t *normal)
{
    float at[3][4];
    float value[3];
    for (uint32_t i = 0u; i < 3u; ++i) {
        for (uint32_t j = 0u; j < 3u; ++j) {
            at[i][j] = normal->at[i][j];
        }
        at[i][3] = normal->at[i][normal->unknowns];
    }
    for (uint32_t pivot = 0u; pivot < 2u; ++pivot) {
        for (uint32_t i = pivot + 1u; i < 3u; ++i) {
            const float part = at[i][pivot] / at[pivot][pivot];
            for (uint32_t j = pivot; j < 4u; ++j) {
                at[i][j] = at[i][j] - part * at[pivot][j];
            }
        }
    }
    value[2] = at[2][3] / at[2][2];
    value[1] = (at[1][3] - at[1][2] * value[2]) / at[1][1];
    value[0] = ((at[0][3] - at[0][1] * value[1]) - at[0][2] * value[2]) / at[0][0];
    if (!are_plausible(normal, 0u, 3u, value)) {
        return -1.0f;
    }
    return (normal->at[0][normal->unknowns] * value[0] + normal->at[1][normal->unknowns] * value[1]) +
           normal->at[2][normal->unknowns] * value[2];
}

/* Forward selection: the limb, or the current, that explains most, then the next one, as long as one exceeds the
 * penalty. In place of the first limb it may be all of them. */
static void select_unknowns(const fk_wear_t *wear, fk_normal_t *normal)
{
    const uint32_t nothing = normal->unknowns;
    const float of_common = normal->at[normal->common][normal->common];
    uint32_t best;
    do {
        float most = FK_WEAR_PENALTY;
        best = nothing;
        if ((normal->chosen & 1u) == 0u) {
            const float gain = gain_of_current(normal);
            if (gain >= most) {
                most = gain;
                best = 0u;
            }
        }
        for (uint32_t at = 3u; at < normal->common; ++at) {
            if (is_chosen(normal, at) == 0) {
                const float gain = gain_of_share(normal, at, wear->information[at * (at + 3u) / 2u]);
                if (gain > most) {
                    most = gain;
                    best = at;
                }
            }
        }
        if ((normal->chosen >> 3u) == 0u &&
            gain_of_share(normal, normal->common, of_common) > most + FK_WEAR_COMMON_BY) {
            best = normal->common;
        }
        if (best != nothing) {
            eliminate(normal, best);
        }
        if (best == 0u) {
            eliminate(normal, 1u);
            eliminate(normal, 2u);
        }
    } while (best != nothing);
}

/* The last unknown, which changes all limbs alike: its row and column are the sums of theirs. */
static void sum_of_limbs(fk_normal_t *normal)
{
    float *const row = normal->at[normal->common];
    float own = 0.0f;
    for (uint32_t j = 0u; j <= normal->unknowns; ++j) {
        row[j] = 0.0f;
        if (j != normal->common) {
            for (uint32_t i = 3u; i < normal->common; ++i) {
                row[j] = row[j] + normal->at[i][j];
            }
        }
    }
    for (uint32_t j = 0u; j < normal->common; ++j) {
        normal->at[j][normal->common] = row[j];
        own = own + ((j < 3u) ? 0.0f : row[j]);
    }
    row[normal->common] = own;
}

/* Estimate shares and current from the sums over all periods. */
static void estimate(fk_wear_t *wear, const fk_tables_t *tables)
{
    fk_normal_t normal;
    uint32_t next = 0u;
    normal.common = 3u + tables->limbs;
    normal.unknowns = normal.common + 1u;
    normal.chosen = 0u;
    for (uint32_t i = 0u; i < normal.common; ++i) {
        for (uint32_t j = 0u; j <= i; ++j) {
            normal.at[i][j] = wear->information[next];
            normal.at[j][i] = wear->information[next];
            ++next;
        }
        normal.at[i][normal.unknowns] = wear->vector[i];
    }
    for (uint32_t i = 0u; i < 3u; ++i) {
        normal.at[i][i] += current_information[i];
    }
    sum_of_limbs(&normal);
    select_unknowns(wear, &normal);
    for (uint32_t i = 0u; i < 3u; ++i) {
        wear->current[i] = ((normal.chosen & 1u) != 0u) ? normal.at[i][normal.unknowns] : 0.0f;
    }
    const float common =
        (is_chosen(&normal, normal.common) != 0) ? normal.at[normal.common][normal.unknowns] : 0.0f;
    for (uint32_t limb = 0u; limb < tables->limbs; ++limb) {
        float share = common;
        if (is_chosen(&normal, 3u + limb) != 0) {
            share = share + normal.at[3u + limb][normal.unknowns];
        }
        share = (share < 1.0f) ? share : 1.0f;
        wear->lost[limb] = (share > 0.0f) ? (uint16_t)(share * (float)FK_LOST_MAX + 0.5f) : 0u;
    }
}

/* The part of the current's right-hand side that the limbs explain, with the shares as estimated. */
static float explained_by_limbs(const fk_wear_t *wear, const fk_tables_t *tables, uint32_t current)
{
    float sum = 0.0f;
    for (uint32_t limb = 0u; limb < tables->limbs; ++limb) {
        const uint32_t at = 3u + limb;
        sum = sum + wear->information[at * (at + 1u) / 2u + current] * lost_share(wear->lost[limb]);
    }
    return sum;
}

/* Which limbs do nothing at all, of those that were worn before this period and still are. A wear curve bends at its
 * end, where the robot turns otherwise than while something is left of the limb, and sums over secants cannot tell
 * this. Each period in which the limb fires does: if the curve's end explains it better than the estimated share,
 * everything is lost, until a period says otherwise. The period that first names a limb does not count, as it may be
 * a misfire. */
static void find_gone(fk_wear_t *wear, const fk_tables_t *tables, uint32_t fires, const uint16_t *before,
                      const float error[3], const float weight[3], float row[3][FK_WEAR_UNKNOWNS])
{
    float left[3];
    float changes[3];
    float at_end[3];
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        left[axis] = error[axis];
        for (uint32_t i = 0u; i < 3u; ++i) {
            left[axis] = left[axis] - row[axis][i] * wear->current[i];
        }
    }
    for (uint32_t limb = 0u; limb < tables->limbs; ++limb) {
        if (((fires >> limb) & 1u) != 0u) {
            curve(tables, limb, wear->lost[limb], changes);
            for (uint32_t axis = 0u; axis < 3u; ++axis) {
                left[axis] = left[axis] - changes[axis];
            }
        }
    }
    for (uint32_t limb = 0u; limb < tables->limbs; ++limb) {
        const int32_t was_gone = (before[limb] == FK_LOST_MAX) ? 1 : 0;
        int32_t is_gone = was_gone;
        if (((fires >> limb) & 1u) != 0u) {
            float less = 0.0f;
            curve(tables, limb, wear->lost[limb], changes);
            curve(tables, limb, FK_LOST_MAX, at_end);
            for (uint32_t axis = 0u; axis < 3u; ++axis) {
                const float other = (left[axis] + changes[axis]) - at_end[axis];
                less = less + weight[axis] * (left[axis] * left[axis] - other * other);
            }
            is_gone = (less > ((was_gone != 0) ? -FK_WEAR_GONE_BY : FK_WEAR_GONE_BY)) ? 1 : 0;
        }
        if (before[limb] > 0u && wear->lost[limb] > 0u && is_gone != 0) {
            wear->lost[limb] = FK_LOST_MAX;
        }
    }
}

void fk_wear_learn(fk_wear_t *wear, fk_tables_t *tables, const fk_wear_period_t *period)
{
    float error[3];
    float weight[3];
    float row[3][FK_WEAR_UNKNOWNS];
    float square = 0.0f;
    uint16_t before[FK_LIMBS_MAX];
    uint32_t next = 0u;
    const uint32_t unknowns = 3u + tables->limbs;
    if (wear->learn != FK_LEARN_ON || period->action >= tables->actions) {
        return;
    }
    regression(wear, tables, period, error, row);
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        float left = error[axis];
        for (uint32_t i = 0u; i < unknowns; ++i) {
            const float value = (i < 3u) ? wear->current[i] : lost_share(wear->lost[i - 3u]);
            left = left - row[axis][i] * value;
        }
        weight[axis] = 1.0f / (noise[axis] + period->variance[variance_of[axis]]);
        square = square + weight[axis] * (left * left);
    }
    if (!(square <= FK_WEAR_ERROR_MOST)) { /* also NaN */
        return;
    }
    const float kept = (square > FK_WEAR_OUTLIER) ? FK_WEAR_FADING * FK_WEAR_OUTLIER_FADING : FK_WEAR_FADING;
    for (uint32_t i = 0u; i < unknowns; ++i) {
        const float fading = (i < 3u) ? FK_WEAR_FADING : kept; /* a current does not change as suddenly as a limb breaks */
        const float dropped = (i < 3u) ? (FK_WEAR_FADING - kept) * explained_by_limbs(wear, tables, i) : 0.0f;
        const float faded = fading * wear->vector[i] - dropped;
        const float a = weight[0] * row[0][i];
        const float b = weight[1] * row[1][i];
        const float c = weight[2] * row[2][i];
        for (uint32_t j = 0u; j <= i; ++j) {
            wear->information[next] =
                fading * wear->information[next] + ((a * row[0][j] + b * row[1][j]) + c * row[2][j]);
            ++next;
        }
        wear->vector[i] = faded + ((a * error[0] + b * error[1]) + c * error[2]);
    }
    for (uint32_t limb = 0u; limb < tables->limbs; ++limb) {
        before[limb] = wear->lost[limb];
    }
    estimate(wear, tables);
    find_gone(wear, tables, fires_of(tables, period->action), before, error, weight, row);
    fk_wear_use(wear, tables);
}

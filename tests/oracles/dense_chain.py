"""The chain as a textbook would program it: one dense stiffness matrix, solved anew after every break.

Rows and columns: u_t[0 … N−1], then u[0 … N−1], in units of K; u_t[0] = U is imposed. Springs are assembled one by one, detached
contacts are springs taken out of the matrix, and a semi-infinite right end is found by decimation, which knows nothing of modes.
"""

import numpy as np
from scipy.optimize import brentq

# --- the matrix ------------------------------------------------------------------------------------------------------


def surface_block(bulk, coupling):
    """Effective diagonal block of the first site of a half-line of sites `bulk` joined by `coupling`, removing every other site."""
    surface, inner, left, right = bulk.copy(), bulk.copy(), coupling.copy(), coupling.copy()
    for _ in range(60):
        inverse = np.linalg.inv(inner)
        there, back = left @ inverse @ right, right @ inverse @ left
        surface = surface - there
        inner = inner - there - back
        left, right = left @ inverse @ left, right @ inverse @ right
        if abs(left).max() < 1e-300:
            break
    return surface


def end_stiffness(right, K_L, K, K_T, k):
    """2 × 2 stiffness (upper, layer) of what lies beyond the last site."""
    bond, site = np.diag([K_L, K]), np.array([[K_T, -K_T], [-K_T, K_T + k]])
    if right == "semi-infinite":
        return surface_block(2 * bond + site, bond) - bond - site
    return {"free": 0 * bond, "clamped": bond}[right]


def stiffness_matrix(upper, layer, across, contact, end):
    """All springs: N − 1 bonds of the upper slider and of the layer, N transverse springs, N contacts, and the right end."""
    n = len(contact)
    A = np.zeros((2 * n, 2 * n), np.result_type(upper, layer, across, contact, end, float))

    def spring(i, j, stiffness):
        A[i, i] += stiffness
        A[j, j] += stiffness
        A[i, j] -= stiffness
        A[j, i] -= stiffness

    for i in range(n - 1):
        spring(i, i + 1, upper[i])
        spring(n + i, n + i + 1, layer[i])
    for i in range(n):
        spring(i, n + i, across[i])
        A[n + i, n + i] += contact[i]
    last = np.array([n - 1, 2 * n - 1])
    A[np.ix_(last, last)] += end
    return A


def held(matrix):
    """`matrix` with its first equation replaced by u_t[0] = U."""
    matrix = matrix.copy()
    matrix[0] = 0
    matrix[0, 0] = 1
    return matrix


def uniform_springs(height, stiffness, poisson, sites, right):
    """Arguments of `stiffness_matrix` for the paper's slider."""
    across, one = 1 / (2 * (1 + poisson) * height), np.ones(sites)
    end = end_stiffness(right, height, 1.0, across, stiffness)
    return height * one[1:], one[1:], across * one, stiffness * one, end


def chain_matrix(height, stiffness, poisson, sites, right="semi-infinite", machine=None):
    """The paper's chain, pushed at its edge; through a spring of stiffness `machine`, in K, if there is one."""
    matrix = stiffness_matrix(*uniform_springs(height, stiffness, poisson, sites, right))
    if machine is None:
        return held(matrix)
    matrix[0, 0] += machine
    return matrix


# --- the first precursor of the paper's chain, from its responses; complex numbers pass through ------------------------


def responses(height, stiffness, poisson, sites, right, reach, machine=None):
    """u of the first `reach` sites, for a unit load, shape (reach,), and for unit pinning points, shape (reach, reach)."""
    a = chain_matrix(height, stiffness, poisson, sites, right, machine)
    rhs = np.zeros((2 * sites, 1 + reach), a.dtype)
    rhs[0, 0] = 1 if machine is None else machine
    rhs[sites + np.arange(reach), 1 + np.arange(reach)] = stiffness
    solution = np.linalg.solve(a, rhs)
    solution += np.linalg.solve(a, rhs - a @ solution)  # one step of refinement
    layer = solution[sites : sites + reach]
    return layer[:, 0], layer[:, 1:]


def front_stress(load, pinning, count, prestress=0.0, kept=0.0):
    """Stress on contacts 0 … count − 1 as the front comes to each, in units of the threshold; a broken one has `kept` some."""
    stress = np.zeros(count, load.dtype)
    for s in range(count):
        stress[s] = prestress + (1 - prestress) / load[0] * load[s] + pinning[s, :s] @ (stress[:s] - kept)
    return stress


def crossing(excess, degree=5):
    """ℓ where the polynomial through the last of `excess`, the stresses over threshold as the front came, is zero.

    Of that degree, or through all that there are; complex numbers pass through.
    """
    s0 = len(excess) - 1
    place = np.arange(-min(degree, s0), 1.0)
    polynomial = np.linalg.solve(np.vander(place), excess[-len(place) :])
    zeros = np.roots(polynomial.real)
    zeros = zeros.real[(abs(zeros.imag) < 1e-9) & (zeros.real > -1 - 1e-9) & (zeros.real < 1e-9)]
    x = zeros.max()
    for _ in range(3):
        x = x - np.polyval(polynomial, x) / np.polyval(np.polyder(polynomial), x)
    return s0 + x


def first_precursor(height, stiffness, poisson, sites=400, right="semi-infinite", machine=None):
    """s0, ℓ, load U0 and the largest stress behind the front (and where) at any moment; s0 = sites if it ran through."""
    reach = sites if right != "semi-infinite" else min(sites, 120)
    load, pinning = responses(height, stiffness, poisson, sites, right, reach, machine)
    stress = front_stress(load, pinning, reach)
    below = np.nonzero(stress[1:] < 1)[0]
    if not len(below):
        assert right != "semi-infinite"
        return reach, np.inf, 1 / load[0], None
    s0 = int(below[0]) + 1
    worst = (0.0, 0)
    for s in range(1, s0 + 1):
        broken = np.where(np.arange(reach) < s, stress, 0)
        behind = (load / load[0] + pinning @ broken - broken)[:s]
        worst = max(worst, (float(behind.max()), int(behind.argmax())))
    excess = np.append(0, stress[1 : s0 + 1] - 1)  # contact 0 breaks at its threshold exactly
    return s0, crossing(excess), 1 / load[0], worst


def end_of_event(order, overload, ahead, alike):
    """ℓ from the overload of each contact as it first broke, and the excess ahead of them after the event.

    On a polynomial as of `crossing`, back over contacts that broke after all those to their left, if contacts are `alike` and
    none broke again; else on a straight line.
    """
    right, past = max(order), [min(ahead, 0)]
    for site in range(right, -1, -1):
        left = [order.index(i) for i in overload if i < site]
        if len(past) > 5 or site not in overload or max(left, default=-1) > order.index(site):
            break
        past.append(overload[site] if site < right else max(overload[site], 0))
    if len(past) == 1 or not alike or len(set(order)) < len(order):
        past = [past[0], max(overload[right], 0)]
    return right + 2 - len(past) + crossing(np.array(past[::-1]))


# --- any chain, break by break -----------------------------------------------------------------------------------------


class DenseChain:
    """Contacts of any stiffness, threshold and prestress, broken one by one.

    `delay`: a broken contact repins, at zero stretch, as the nth contact after it breaks, or when the event ends.
    `strength(age)`: threshold over that of an unbroken contact; the clock is the load. `spring`: stiffness of the drive.
    `residual`: share of its threshold that a contact keeps as it breaks, and carries while it is detached.
    """

    def __init__(
        self, upper, layer, across, contact, end, *,
        stiffness, threshold, prestress, delay=0, strength=None, spring=None, residual=0.0,
    ):  # fmt: skip
        n = len(contact)
        self.n, self.k, self.stiffness, self.threshold, self.prestress = n, contact, stiffness, threshold, prestress
        self.delay, self.strength, self.spring = delay, strength, spring
        self.matrix = stiffness_matrix(upper, layer, across, contact, end)
        self.pushed = held(self.matrix)
        if spring is not None:
            self.pushed[0] = self.matrix[0]
            self.pushed[0, 0] += spring
        self.inverse = np.linalg.inv(self.pushed)
        with np.errstate(divide="ignore", invalid="ignore"):  # stretch that carries the prestress
            self.carrying = np.where(contact > 0, prestress * stiffness / contact, 0.0)
        self.pinning, self.load = np.zeros(n), 0.0
        self.attached, self.born = np.ones(n, bool), np.full(n, -np.inf)
        self.residual, self.kept = residual, np.zeros(n)

    @classmethod
    def uniform(cls, slider, threshold, prestress, right="free", **more):
        """The paper's chain under any thresholds and prestress; `slider` = (H/λc, k/K, ν)."""
        springs = uniform_springs(*slider, len(threshold), right)
        return cls(*springs, stiffness=slider[1], threshold=threshold, prestress=prestress, **more)

    def at(self, pinning=None, load=None):
        """Put the chain at this state."""
        self.pinning = self.pinning if pinning is None else np.array(pinning, float)
        self.load = self.load if load is None else load
        return self

    def fields(self):
        """u_t and u in equilibrium: a dense solve, polished by one step of iterative refinement."""
        n = self.n
        rhs = np.zeros(2 * n)
        rhs[0] = self.load if self.spring is None else self.spring * self.load
        rhs[n:] = self.k * self.pinning
        if self.attached.all():
            x = self.inverse @ rhs
            x += self.inverse @ (rhs - self.pushed @ x)
        else:  # the tractions that balance the prestress go on pulling where the contact is gone
            gone = np.nonzero(~self.attached)[0]
            matrix = self.pushed.copy()
            matrix[n + gone, n + gone] -= self.k[gone]
            rhs[n + gone] = self.stiffness * (self.prestress - self.kept)[gone]
            x = np.linalg.solve(matrix, rhs)
        return x[:n], x[n:]

    def _stress(self, layer):
        carried = np.where(self.attached, self.k / self.stiffness * (layer - self.pinning) + self.prestress, self.kept)
        return np.where(self.k > 0, carried, 0.0)

    def stress(self):
        """Stress of every contact, prestress included, in σ_s."""
        return self._stress(self.fields()[1])

    def thresholds(self):
        """Present threshold of every contact."""
        if self.strength is None:
            return self.threshold
        age = np.where(np.isinf(self.born), 0, self.load - self.born)
        return self.threshold * np.where(np.isinf(self.born), 1, self.strength(age))

    def push(self):
        """Force of the drive, in K u_s."""
        u_t, u = self.fields()
        return self.spring * (self.load - u_t[0]) if self.spring else self.matrix[0] @ np.concatenate([u_t, u])

    def energy(self):
        """Potential energy of springs, contacts, drive and the tractions that balance the prestress, in K u_s²."""
        n = self.n
        u_t, u = self.fields()
        x, springs = np.concatenate([u_t, u]), self.matrix.copy()
        springs[range(n, 2 * n), range(n, 2 * n)] -= self.k
        anchor = np.where(self.attached, self.pinning, u + self.carrying)
        contacts = 0.5 * self.k @ (u - anchor) ** 2 - self.k * self.carrying @ anchor
        drive = 0.5 * self.spring * (self.load - u_t[0]) ** 2 if self.spring else 0.0
        return 0.5 * x @ springs @ x + contacts + drive

    def next_break(self):
        """Load at which the first contact reaches its threshold, and that contact; below the present load if one is over already."""
        now, load = self.stress(), self.load
        rise = self.at(load=load + 1).stress() - now
        self.load = load
        with np.errstate(divide="ignore", invalid="ignore"):
            wait = np.where((self.k > 0) & (rise > 0), (self.threshold - now) / rise, np.inf)
        if self.strength is not None:
            wait = np.array([self._wait(i, now[i], rise[i]) for i in range(self.n)])
        return load + wait.min(), int(wait.argmin())

    def _wait(self, i, now, rise):
        """Load until an ageing contact breaks, bracketed on a fine grid."""

        def gap(d):
            age = self.load + d - self.born[i]
            return self.threshold[i] * (1.0 if np.isinf(self.born[i]) else self.strength(age)) - now - rise * d

        grid = np.linspace(0, 30, 3001)
        below = np.nonzero(gap(grid) <= 0)[0]
        if not len(below):
            return np.inf
        j = below[0]
        return brentq(gap, grid[j - 1], grid[j], xtol=1e-15, rtol=1e-15) if j else 0.0

    def event(self, step=None):
        """Load to the next break, or in steps until a contact is over its threshold, and let the chain rupture."""
        if step is None:
            load, first = self.next_break()
            return self.at(load=max(load, self.load)).rupture(first)
        self.load += step
        while (self.stress() < self.thresholds()).all():
            self.load += step
        return self.rupture()

    def rupture(self, first=None, max_breaks=10**6):
        """Break `first`, then the most overloaded contact again and again, until none is over its threshold; their order."""
        order, waiting, self.overload = [], [], {}
        layer = self.fields()[1]
        over = np.where(self.attached & (self.k > 0), self._stress(layer) - self.thresholds(), -np.inf)
        site = int(over.argmax()) if first is None else first
        while not order or (over[site] >= 0 and len(order) < max_breaks):
            self.overload.setdefault(site, over[site])
            self.kept[site] = self.residual * self.thresholds()[site]
            if self.delay:
                if len(waiting) == self.delay:
                    self._repin(waiting.pop(0), layer)
                waiting.append(site)
                self.attached[site] = False
            else:
                self._repin(site, layer)
            self.born[site] = self.load
            order.append(site)
            layer = self.fields()[1]
            over = np.where(self.attached & (self.k > 0), self._stress(layer) - self.thresholds(), -np.inf)
            site = int(over.argmax())
        for i in waiting:
            self._repin(i, layer)
        return order

    def _repin(self, i, layer):
        self.attached[i] = True
        self.pinning[i] = layer[i] + self.carrying[i] - self.kept[i] * self.stiffness / self.k[i]

    def reach(self, order, alike=False):
        """ℓ of the event just over: where the stress over threshold passes zero ahead of the rightmost contact.

        On the `end_of_event`, of a chain that was uniform and unbroken before if `alike`.
        """
        right = max(order)
        if right == self.n - 1:
            return np.inf
        return end_of_event(order, self.overload, (self.stress() - self.thresholds())[right + 1], alike)


def front(height, stiffness, poisson, threshold, prestress, delay, sites=200, right="semi-infinite"):
    """A front from the edge, contact after contact: count, stress over threshold as it came to each, load, stresses at arrest."""
    chain = DenseChain.uniform((height, stiffness, poisson), threshold, prestress, right)
    rest = chain.stress()[0]
    chain.load = (threshold[0] - rest) / (chain.at(load=1.0).stress()[0] - rest)
    excess, s = [0.0], 0
    while excess[-1] >= 0 and s < sites:
        layer = chain.fields()[1]
        chain.attached[s] = False
        if s >= delay:
            chain._repin(s - delay, layer)
        s += 1
        if s < sites:
            excess.append(chain.stress()[s] - threshold[s])
    return s, np.array(excess), chain.load, chain.stress()


def ages(law, newborn, scale):
    """Strength of a contact by its age, over that of an old one."""
    if law == "exponential":
        return lambda a: newborn + (1 - newborn) * (1 - np.exp(-a / scale))
    return lambda a: newborn + (1 - newborn) * np.minimum(np.log2(1 + a / scale), 1)

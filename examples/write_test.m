% Writes one test in two forms that pysindy_nrf reads; MATLAB and Octave.
%
%   shaker_test.mat  (v7)  one variable a channel, SI units
%   shaker_test.csv        one column a channel, its unit in the header
%
% Then:  pysindy-nrf run shaker_test.mat    or    pysindy-nrf run shaker_test.csv
%
% The name of a variable or column is its channel: t (s), F1.. (N, applied force on a floor), a1.. (m/s^2, absolute
% acceleration), v1.. (m/s) and x1.. (m, relative to the base), ag (m/s^2, the base). Put your own columns in their place;
% a floor without F is known to be unforced.

% a frame of two floors, 12 and 10 kg, shaken on floor 2 (average-acceleration Newmark)
fs = 500;
t = (0:4999)' / fs;
M = diag([12 10]);
K = [9e4 -4e4; -4e4 4e4];
C = [90 -40; -40 40];
force = [0 * t, 80 * sin(2 * pi * (1 + 0.6 * t) .* t)];
x = zeros(numel(t), 2);
v = x;
a = x;
h = 1 / fs;
S = M + h / 2 * C + h^2 / 4 * K;
for i = 1:numel(t) - 1
    ahead = x(i, :)' + h * v(i, :)' + h^2 / 4 * a(i, :)';
    rate = v(i, :)' + h / 2 * a(i, :)';
    a(i + 1, :) = (S \ (force(i + 1, :)' - C * rate - K * ahead))';
    v(i + 1, :) = (rate + h / 2 * a(i + 1, :)')';
    x(i + 1, :) = (ahead + h^2 / 4 * a(i + 1, :)')';
end

% v7: read without further packages (v7.3 is read too, with h5py)
F2 = force(:, 2);
a1 = a(:, 1);
a2 = a(:, 2);
x1 = x(:, 1);
x2 = x(:, 2);
save('shaker_test.mat', 't', 'F2', 'a1', 'a2', 'x1', 'x2', '-v7');

% 9.80665 m/s^2 is one g
file = fopen('shaker_test.csv', 'w');
fprintf(file, 't [s],F2 [kN],a1 [g],a2 [g],x1 [mm],x2 [mm]\n');
fprintf(file, '%.12g,%.12g,%.12g,%.12g,%.12g,%.12g\n', [t, F2 / 1e3, a / 9.80665, 1e3 * x]');
fclose(file);

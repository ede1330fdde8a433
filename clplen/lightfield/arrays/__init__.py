"""Operations on arrays of views and pictures: imports compute alone; arrays and numbers leave."""
